"""Serve the small driver by llama.cpp, in this process or as a program.

    pip install xllamacpp
    python serve.py      # prints DURA_LLM_BASE_URL=... DURA_LLM_MODEL=..., and ends with its input

One slot and no cache of prompts: how the work is split into batches would change the last bits of
the sums, and equal requests then may have unequal answers.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

NAME = "tiny-driver"
MODEL = Path(__file__).with_name("tiny-driver.gguf")
ABOUT = "a Llama of a million parameters, trained from nothing for this suite"
CONTEXT = 2048
"""Tokens of prompt and answer; a prompt of the suite has less than 300."""


def start(model: Path = MODEL, port: int = 0):
    """llama.cpp's server in this process; its URL is ``listening_address``."""
    import xllamacpp

    parameters = xllamacpp.CommonParams()
    parameters.model.path = str(model)
    parameters.model_alias = {NAME}
    parameters.n_ctx = CONTEXT
    parameters.n_parallel = 1
    parameters.cache_prompt = False
    parameters.cache_ram_mib = 0
    parameters.cpuparams.n_threads = 1
    parameters.cpuparams_batch.n_threads = 1
    parameters.hostnames = ["127.0.0.1"]
    parameters.port = port
    parameters.ui = False
    parameters.offline = True
    parameters.warmup = False
    parameters.verbosity = 0
    return xllamacpp.Server(parameters)


@contextlib.contextmanager
def served(model: Path = MODEL) -> Iterator[dict[str, str]]:
    """Run the server in a process of its own; gives what the planner's environment needs."""
    command = [sys.executable, __file__, "--model", str(model)]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        environment = dict(part.split("=", 1) for part in line.split())
        if "DURA_LLM_BASE_URL" not in environment:
            raise RuntimeError("the server did not start: is xllamacpp installed?")
        yield {**environment, "DURA_LLM_ABOUT": ABOUT}
    finally:
        process.stdin.close()
        try:
            process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--model", type=Path, default=MODEL)
    parser.add_argument("--port", type=int, default=0, help="0, the default, for any free one")
    options = parser.parse_args()
    server = start(options.model, options.port)
    print(f"DURA_LLM_BASE_URL={server.listening_address}/v1 DURA_LLM_MODEL={NAME}", flush=True)  # noqa: T201 - whoever started it waits for this line
    while sys.stdin.buffer.read(4096):
        pass
    os._exit(0)  # freeing the server waits for threads of llama.cpp's, now and then for ever


if __name__ == "__main__":
    main()
