"""The port's client of OpenAI-compatible servers."""

from pytest_dura.llm.client.chat import OpenAiClient

__all__ = ["OpenAiClient"]
