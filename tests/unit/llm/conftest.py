"""What the tests of language models share."""

from __future__ import annotations

from llm_servers import null_server, scripted_server

__all__ = ["null_server", "scripted_server"]
