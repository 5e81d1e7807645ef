"""The body of a chat completion's request."""

from __future__ import annotations

import base64
import io
from typing import Any
from urllib.parse import urlsplit

from pytest_dura.llm.extra import imported
from pytest_dura.llm.port import Image, Message, Request


def body_of(request: Request, base_url: str) -> dict[str, Any]:
    """What is sent, as plain data.

    OpenAI's own servers refuse ``max_tokens`` for their newer models; other servers know it alone.
    """
    host = urlsplit(base_url).hostname or ""
    bound = "max_completion_tokens" if host.endswith(".openai.com") else "max_tokens"
    body: dict[str, Any] = {
        "model": request.model,
        "messages": [_message(one) for one in request.messages],
        "temperature": request.temperature,
        bound: request.max_tokens,
    }
    if request.seed is not None:
        body["seed"] = request.seed
    return body | _response_format(request)


def _response_format(request: Request) -> dict[str, Any]:
    schema = dict(request.schema)
    if request.structured == "json_schema":
        named = {"name": "answer", "strict": True, "schema": schema}
        return {"response_format": {"type": "json_schema", "json_schema": named}}
    if request.structured == "json_object_schema":
        return {"response_format": {"type": "json_object", "schema": schema}}
    if request.structured == "json_object":
        return {"response_format": {"type": "json_object"}}
    return {}


def _message(message: Message) -> dict[str, Any]:
    """Text alone stays plain text: many servers read nothing else."""
    if not message.images:
        return {"role": message.role, "content": message.text}
    parts: list[dict[str, Any]] = [
        {"type": "image_url", "image_url": {"url": data_url(image)}} for image in message.images
    ]
    return {"role": message.role, "content": [*parts, {"type": "text", "text": message.text}]}


def data_url(image: Image) -> str:
    """The picture as a PNG in a ``data:`` URL; every pixel stays as it is."""
    pictures = imported("PIL.Image")
    file = io.BytesIO()
    pictures.fromarray(image.pixels).convert("RGB").save(file, "PNG")
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode()
