"""Scripted servers that speak as real ones do: what they refuse, where things are, how they err.

    with ScriptedServer(otherwise=vllm(answer), models=VLLM_MODELS) as server:

Each dialect is a behaviour of :mod:`scripted_server`; ``answer(request)`` gives the model's text,
which a server that was asked for a schema holds to it. They are written after the servers'
documentation and sources, and are no substitute for them.
"""

from __future__ import annotations

import json
from typing import Any

from scripted_server import completion

KEPT = {"words": ["sea"], "sentence": "The sea.", "mood": "calm"}
"""An answer to the probe's schema."""


def listing(model, **entry):
    """The list of models with one entry."""
    return {"object": "list", "data": [{"id": model, "object": "model", **entry}]}


def refusal(exchange, status, message, *, code=None, param=None, headers=None):
    """Sends OpenAI's error object."""
    error = {"message": message, "type": "invalid_request_error", "param": param, "code": code}
    exchange.send({"error": error}, status, headers=headers)


def schema_of(body):
    """The schema to which the body asks the server to hold its answer; None if it does not."""
    form = body.get("response_format") or {}
    if form.get("type") == "json_schema":
        return form["json_schema"]["schema"]
    return None


def held(body, answer, request):
    """The text of a server that holds answers to schemas."""
    schema = schema_of(body)
    if schema is not None and "mood" in schema.get("properties", {}):
        return json.dumps(KEPT)
    return answer(request)


def streams(exchange, content, *, thoughts="", field="reasoning_content", pause=0.0, size=7):
    """A completion in parts: first the thoughts, then the text, then the usage."""
    chunked = exchange._handler.protocol_version == "HTTP/1.1"
    coding = {"Transfer-Encoding": "chunked"} if chunked else {}
    exchange.start(kind="text/event-stream; charset=utf-8", headers=coding)

    def write(data):
        exchange.write(b"%x\r\n%s\r\n" % (len(data), data) if chunked else data)

    def event(data):
        write(b"data: " + json.dumps(data).encode() + b"\n\n")

    def chunk(delta, finish=None):
        event({"object": "chat.completion.chunk", "system_fingerprint": "fp_scripted",
               "choices": [{"index": 0, "delta": delta, "finish_reason": finish}]})  # fmt: skip

    chunk({"role": "assistant", "content": ""})
    exchange.sleep(pause)
    for name, text in ((field, thoughts), ("content", content)):
        for start in range(0, len(text), size):
            chunk({name: text[start : start + size]})
    chunk({}, "stop")
    event({"choices": [], "usage": {"prompt_tokens": 10, "completion_tokens": 5,
                                    "total_tokens": 15}})  # fmt: skip
    write(b"data: [DONE]\n\n")
    if chunked:
        exchange.write(b"0\r\n\r\n")


def vllm(answer, *, thoughts="V1 comes. I wait.", pause=0.0):
    """vLLM with a reasoning parser: thoughts in ``reasoning_content``, unless the chat template is
    told to leave them out; every schema held; a field that it does not know is refused."""
    known = {
        "model", "messages", "temperature", "max_tokens", "max_completion_tokens", "seed", "top_p",
        "top_k", "stream", "stream_options", "response_format", "tools", "tool_choice",
        "chat_template_kwargs",
    }  # fmt: skip

    def behave(exchange):
        body = exchange.request.json
        unknown = set(body) - known
        if unknown or (body.get("response_format") or {}).get("schema"):
            refusal(exchange, 400, f"Extra inputs are not permitted: {sorted(unknown)}")
            return
        thinks = (body.get("chat_template_kwargs") or {}).get("enable_thinking", True)
        text, thought = held(body, answer, exchange.request), thoughts if thinks else ""
        if body.get("stream"):
            streams(exchange, text, thoughts=thought, pause=pause)
            return
        whole = completion(text)
        whole["choices"][0]["message"]["reasoning_content"] = thought or None
        exchange.send(whole)

    return behave


VLLM_MODELS = listing(
    "my-org/my-model", owned_by="vllm", root="my-org/my-model", max_model_len=8192
)


def llama_cpp(answer):
    """llama.cpp's server: grammars of schemas, but an error 500 for strings without a bound, for
    pictures and, at first, while it loads its model; thoughts stay in the text."""
    state = {"loading": True}

    def unbounded(schema):
        if schema.get("type") == "string":
            return "maxLength" not in schema and "enum" not in schema
        parts = [*schema.get("properties", {}).values(), *filter(None, [schema.get("items")])]
        return any(map(unbounded, parts))

    def behave(exchange):
        body = exchange.request.json
        if state.pop("loading", False):
            refusal(exchange, 503, "Loading model", code=503)
            return
        if any(isinstance(message["content"], list) for message in body["messages"]):
            refusal(exchange, 500, "image input is not supported - hint: provide the mmproj")
            return
        schema = schema_of(body)
        if schema is not None and unbounded(schema):
            refusal(exchange, 500, "failed to parse grammar")
            return
        text = held(body, answer, exchange.request)
        exchange.send(completion(text if schema else f"<think>\nHm. {{}}\n</think>\n\n{text}"))

    return behave


LLAMA_CPP_MODELS = listing("my-model.gguf", owned_by="llamacpp", meta={"n_ctx": 4096})


def ollama(answer, *, model="my-model:8b"):
    """Ollama: no key is looked at; another model is not found; thoughts stand in ``reasoning``."""

    def behave(exchange):
        body = exchange.request.json
        if body["model"] != model:
            refusal(exchange, 404, f"model '{body['model']}' not found", code="not_found")
            return
        whole = completion(held(body, answer, exchange.request))
        whole["choices"][0]["message"]["reasoning"] = "The way is clear."
        exchange.send(whole)

    return behave


OLLAMA_MODELS = listing("my-model:8b", owned_by="library")


def cloud(answer, *, key, organisation, busy=1):
    """A cloud's API for a reasoning model: it wants a key and an organisation, refuses
    ``max_tokens``, any temperature but 1 and bounds of strings in strict schemas, offers tools, and
    is busy at times, for a millisecond."""
    seen: dict[str, int] = {}

    def behave(exchange):
        body, headers = exchange.request.json, exchange.request.headers
        if headers.get("authorization") != f"Bearer {key}":
            shown = headers.get("authorization", "nothing")
            refusal(exchange, 401, f"Incorrect API key provided: {shown}", code="invalid_api_key")
        elif headers.get("openai-organization") != organisation:
            refusal(exchange, 401, "No such organization", code="invalid_organization")
        elif "max_tokens" in body:
            refusal(
                exchange, 400, "Unsupported parameter: 'max_tokens' is not supported with this "
                "model. Use 'max_completion_tokens' instead.", code="unsupported_parameter",
                param="max_tokens",
            )  # fmt: skip
        elif body.get("temperature", 1) != 1:
            refusal(
                exchange, 400, "Unsupported value: 'temperature' does not support "
                f"{body['temperature']} with this model. Only the default (1) value is supported.",
                code="unsupported_value", param="temperature",
            )  # fmt: skip
        elif schema_of(body) is not None:
            refusal(
                exchange, 400, "Invalid schema for response_format 'answer': 'maxLength' is not "
                "permitted.", code="invalid_request_error",
            )  # fmt: skip
        elif (body.get("response_format") or {}).get("schema"):
            refusal(exchange, 400, "Unknown parameter: 'response_format.schema'.")
        elif seen.setdefault(key_of(body), busy):
            seen[key_of(body)] -= 1
            refusal(exchange, 429, "Rate limit reached", code="rate_limit_exceeded",
                    headers={"Retry-After": "0.001"})  # fmt: skip
        else:
            exchange.send(chosen(body, answer, exchange.request))

    return behave


def key_of(body: Any) -> str:
    return json.dumps(body, sort_keys=True)


def chosen(body, answer, request):
    """A completion that calls the tool it was told to call."""
    if "tool_choice" not in body:
        return completion(answer(request))
    parameters = body["tools"][0]["function"]["parameters"]
    text = json.dumps(KEPT) if "mood" in parameters["properties"] else answer(request)
    whole = completion(None)
    function = {"name": body["tool_choice"]["function"]["name"], "arguments": text}
    call = {"id": "call_1", "type": "function", "function": function}
    whole["choices"][0]["message"]["tool_calls"] = [call]
    return whole


def azure(answer, *, key, version):
    """Azure's deployments: the key in ``api-key``, the version in the query, a filter that errs."""

    def behave(exchange):
        path, _, query = exchange.request.path.partition("?")
        headers, body = exchange.request.headers, exchange.request.json
        if query != f"api-version={version}" or "/openai/deployments/" not in path:
            refusal(exchange, 404, "Resource not found", code="404")
        elif headers.get("api-key") != key or "authorization" in headers:
            refusal(exchange, 401, "Access denied due to invalid subscription key", code="401")
        elif "how to hurt" in exchange.request.prompt.lower():
            refusal(exchange, 400, "The response was filtered", code="content_filter")
        else:
            exchange.send(completion(held(body, answer, exchange.request)))

    return behave
