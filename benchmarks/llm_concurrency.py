"""A session with a language model at 0.3 s a call: one request after the other, and 8 at once.

Run: python benchmarks/llm_concurrency.py [--runs 15] [--serial-runs 1] [--select GLOB]

The six built-in scenarios of the intersection with the planner of `llm`, whose server on loopback
sleeps before each answer and takes so many requests at once; the others have to wait. The sessions
are live and apart from their runs the same. They are compared by their requests per second from
start to end, imports, probe and evidence included; where they have equal runs, that is also how
much faster the second one ends. CPU seconds are those of the sessions: where they come near the
seconds of the clock, a core and not the server is what the session waits for.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from machine import machine, table

from pytest_dura.evidence import open_record
from pytest_dura.llm.record import models_of

SUPPORT = Path(__file__).parents[1] / "tests" / "support"
sys.path.insert(0, str(SUPPORT))

from careful_model import careful  # noqa: E402 - support modules lie elsewhere
from models import said  # noqa: E402

NAME = "scripted"


class Handler(BaseHTTPRequestHandler):
    """Answers like a careful model, after a while."""

    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    server: Server

    def do_GET(self) -> None:
        self.answer({"object": "list", "data": [{"id": NAME, "object": "model"}]})

    def do_POST(self) -> None:
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        content = body["messages"][-1]["content"]
        text = content if isinstance(content, str) else content[-1]["text"]
        with self.server.places:
            time.sleep(self.server.seconds)
        told = careful(text if "EGO" in text else "EGO: speed 0.0")
        answer = said(told["maneuver"], told["intent"], told["ids"])
        message = {"role": "assistant", "content": answer}
        choice = {"index": 0, "message": message, "finish_reason": "stop"}
        usage = {"prompt_tokens": len(text) // 4, "completion_tokens": len(answer) // 4}
        self.answer({"object": "chat.completion", "choices": [choice], "usage": usage})

    def answer(self, data: dict[str, Any]) -> None:
        body = json.dumps(data).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: Any) -> None:
        """Write nothing."""


class Server(ThreadingHTTPServer):
    """The server on loopback.

    Args:
        seconds: Before each answer.
        places: Requests that are answered at once.
    """

    daemon_threads = True

    def __init__(self, seconds: float, places: int) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.seconds, self.places = seconds, threading.BoundedSemaphore(places)


@contextmanager
def served(seconds: float, places: int) -> Iterator[str]:
    """The base URL of a server that runs meanwhile."""
    server = Server(seconds, places)
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/v1"
    finally:
        server.shutdown()
        server.server_close()


def session(
    folder: Path, url: str, runs: int, concurrency: int, more: Sequence[str]
) -> dict[str, Any]:
    """Run a session; returns what it took."""
    evidence = folder / f"at-once-{concurrency}"
    command = [
        *(sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--dura-scenarios"),
        *("--dura-generator=llm", "--dura-time-budget=30", f"--dura-runs={runs}"),
        *(f"--dura-evidence={evidence}", f"--dura-llm-concurrency={concurrency}", *more),
    ]
    named = {"DURA_LLM_BASE_URL": url, "DURA_LLM_MODEL": NAME}
    spent, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(
        command, cwd=folder, env=os.environ | named, capture_output=True, text=True, check=False
    )
    seconds, now = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode not in {0, 1}:  # 1: the model need not meet the requirements
        sys.exit(done.stdout + done.stderr)
    record = open_record(evidence / "evidence.json")
    return {
        "at once": concurrency,
        "episodes": len(list(record.episodes())),
        "requests": sum(model.asked for model in models_of(record.head)),
        "seconds": seconds,
        "cpu": now.ru_utime + now.ru_stime - spent.ru_utime - spent.ru_stime,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--serial-runs", type=int, default=1)
    parser.add_argument("--concurrency", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=0.3, help="before each answer")
    parser.add_argument("--select", default="intersection/*")
    parser.add_argument("--path", type=Path, help="with further scenario files")
    options = parser.parse_args()
    more = [f"--dura-select={options.select}"]
    more += [] if options.path is None else [f"--dura-path={options.path.absolute()}"]
    print(f"Measured on: {machine()}\n")
    rows = []
    with (
        tempfile.TemporaryDirectory() as folder,
        served(options.seconds, options.concurrency) as url,
    ):
        for runs, at_once in ((options.serial_runs, 1), (options.runs, options.concurrency)):
            rows.append(session(Path(folder), url, runs, at_once, more))
    rates = [row["requests"] / row["seconds"] for row in rows]
    headers = ["requests at once", "episodes", "requests", "s", "requests/s", "ms per request",
               "CPU s", "times as many requests/s"]  # fmt: skip
    cells = [
        [str(row["at once"]), str(row["episodes"]), str(row["requests"]), f"{row['seconds']:.1f}",
         f"{rate:.2f}", f"{1000 / rate:.0f}", f"{row['cpu']:.1f}", f"{rate / rates[0]:.2f}"]
        for row, rate in zip(rows, rates, strict=True)
    ]  # fmt: skip
    print(table(headers, cells))


if __name__ == "__main__":
    main()
