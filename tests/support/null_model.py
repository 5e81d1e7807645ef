"""A real OpenAI-compatible server without a download: llama.cpp, a tiny model, random weights.

It proves the wire, the parsing, the limits and the figures. It is a null model and knows nothing
of driving: its answers obey a JSON schema because llama.cpp's grammar allows no others.

As a program: ``python tests/support/null_model.py --port 8123`` prints one line when it is ready,
``DURA_LLM_BASE_URL=http://127.0.0.1:8123/v1 DURA_LLM_MODEL=null``, and ends when its standard input
closes, upon SIGTERM or SIGINT, or after ``--at-most`` seconds.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

MODEL = "null"
CONTEXT = 16384  # tokens; the tokenizer is byte-level, so nearly as many characters
SEED = 2718

WIDTH, LAYERS, HEADS, INNER = 64, 2, 1, 128  # one head: many small ones are several times slower
BYTES = 3  # the first byte token, after <unk> <s> </s>
SPACE = "\u2581"  # how a tokenizer of this kind writes a space
VOCABULARY = ["<unk>", "<s>", "</s>", *(f"<0x{byte:02X}>" for byte in range(256)), SPACE]
KINDS = [2, 3, 3, *[6] * 256, 1]  # unknown, control, control, bytes, normal
# Letters are lifted so that answers are legible; what ends a text, so that it ends long before its
# bound, like that of a model that writes; and the zero, so that numbers stay near it. In logits.
LETTERS = [*(BYTES + ord(letter) for letter in "abcdefghijklmnopqrstuvwxyz"), BYTES + 256]
ENDS = [VOCABULARY.index("</s>"), BYTES + ord('"')]
ZERO = BYTES + ord("0")
LIFT_OF_LETTERS, LIFT_OF_ENDS, LIFT_OF_ZERO = 5.5, 5.9, 7.0
# Random bytes are no UTF-8, and llama.cpp answers 500 where its grammar let such through.
NOT_ASCII = [BYTES + byte for byte in range(0x80, 0x100)]
LIFT_OF_NOT_ASCII = -30.0
CONSTANT = 8.0  # the first component of each token's embedding, beside others of about 1
SHARPNESS = 4.0  # the gain of queries and keys: high, so that answers depend on the prompt
SPREAD = 1.5  # of the logits

TEMPLATE = (
    "{% for message in messages %}[{{ message['role'] }}] {{ message['content'] }}\n{% endfor %}"
    "{% if add_generation_prompt %}[assistant] {% endif %}"
)


def missing():
    """Why the server cannot run here, or None."""
    absent = [name for name in ("xllamacpp", "gguf") if importlib.util.find_spec(name) is None]
    return f"{' and '.join(absent)} not installed" if absent else None


def write_model(path, seed=SEED):
    """Writes the model as a GGUF file: equal bytes for equal seeds."""
    import gguf

    writer = gguf.GGUFWriter(path, "llama")
    writer.add_name(MODEL)
    writer.add_context_length(CONTEXT)
    writer.add_embedding_length(WIDTH)
    writer.add_block_count(LAYERS)
    writer.add_feed_forward_length(INNER)
    writer.add_head_count(HEADS)
    writer.add_head_count_kv(HEADS)
    writer.add_rope_dimension_count(WIDTH // HEADS)
    writer.add_layer_norm_rms_eps(1e-5)
    writer.add_vocab_size(len(VOCABULARY))
    writer.add_file_type(gguf.LlamaFileType.ALL_F32)
    writer.add_tokenizer_model("llama")
    writer.add_token_list([token.encode() for token in VOCABULARY])
    writer.add_token_scores([0.0] * len(VOCABULARY))
    writer.add_token_types(KINDS)
    writer.add_unk_token_id(0)
    writer.add_bos_token_id(1)
    writer.add_eos_token_id(2)
    writer.add_add_bos_token(True)
    writer.add_add_eos_token(False)
    writer.add_add_space_prefix(False)
    writer.add_chat_template(TEMPLATE)
    for name, tensor in _tensors(seed):
        writer.add_tensor(name, tensor)
    writer.write_header_to_file()
    writer.write_kv_data_to_file()
    writer.write_tensors_to_file()
    writer.close()


def _tensors(seed):
    """Names as llama.cpp expects them, and float32 arrays."""
    import numpy as np

    generator = np.random.default_rng(seed)

    def random(rows, columns, gain=1.0):
        matrix = generator.standard_normal((rows, columns)) * (gain / np.sqrt(columns))
        return matrix.astype(np.float32)

    ones = np.ones(WIDTH, dtype=np.float32)
    # The first component of the residual stream is the same for every token, and no layer reads it
    # or writes to it: what `output.weight` holds there raises logits. A llama has no other bias.
    embedding = random(len(VOCABULARY), WIDTH, WIDTH**0.5)
    embedding[:, 0] = CONSTANT
    yield "token_embd.weight", embedding
    for layer in range(LAYERS):
        block = f"blk.{layer}"
        yield f"{block}.attn_norm.weight", ones
        for part, gain in (("q", SHARPNESS), ("k", SHARPNESS), ("v", 1.0)):
            yield f"{block}.attn_{part}.weight", _blind(random(WIDTH, WIDTH, gain))
        yield f"{block}.attn_output.weight", _mute(random(WIDTH, WIDTH))
        yield f"{block}.ffn_norm.weight", ones
        yield f"{block}.ffn_gate.weight", _blind(random(INNER, WIDTH))
        yield f"{block}.ffn_up.weight", _blind(random(INNER, WIDTH))
        yield f"{block}.ffn_down.weight", _mute(random(WIDTH, INNER))
    yield "output_norm.weight", ones
    output = _blind(random(len(VOCABULARY), WIDTH, SPREAD))
    output[LETTERS, 0] = LIFT_OF_LETTERS / CONSTANT
    output[ENDS, 0] = LIFT_OF_ENDS / CONSTANT
    output[NOT_ASCII, 0] = LIFT_OF_NOT_ASCII / CONSTANT
    output[ZERO, 0] = LIFT_OF_ZERO / CONSTANT
    yield "output.weight", output


def _blind(matrix):
    matrix[:, 0] = 0.0
    return matrix


def _mute(matrix):
    matrix[0, :] = 0.0
    return matrix


def start(model, port=0, *, cache_prompt=False):
    """llama.cpp's server in this process; freed with ``del`` and a collection of garbage.

    Args:
        model: The GGUF file.
        port: 0 for any free one.
        cache_prompt: Whether what two prompts share is evaluated once. It changes how the work is
            split into batches and so the last bits of the sums: equal requests then may have
            unequal answers. For the same reason there is one slot, and requests wait for each
            other.
    """
    import xllamacpp

    parameters = xllamacpp.CommonParams()
    parameters.model.path = str(model)
    parameters.model_alias = {MODEL}
    parameters.n_ctx = CONTEXT
    parameters.n_parallel = 1
    parameters.cache_prompt = cache_prompt
    parameters.cache_ram_mib = 0
    parameters.cpuparams.n_threads = 1  # waiting for a second thread costs more than it does
    parameters.cpuparams_batch.n_threads = 1
    parameters.hostnames = ["127.0.0.1"]
    parameters.port = port
    parameters.ui = False
    parameters.offline = True
    parameters.warmup = False
    parameters.verbosity = 0
    return xllamacpp.Server(parameters)


@dataclass(frozen=True)
class NullServer:
    """A server that runs: its base URL (with ``/v1``), its model's name and its process."""

    base_url: str
    model: str
    process: subprocess.Popen

    @property
    def environment(self):
        """The variables that its line names."""
        return {"DURA_LLM_BASE_URL": self.base_url, "DURA_LLM_MODEL": self.model}


@contextlib.contextmanager
def null_model_server(directory, *, at_most=3600, cache_prompt=False, ready_within=60):
    """Runs the server in a process of its own, so that it cannot take the caller with it.

    Args:
        directory: Where the model is written, once.
        at_most: Seconds after which it ends by itself.
        cache_prompt: See :func:`start`.
        ready_within: Seconds to wait for it.

    Raises:
        RuntimeError: It did not become ready; with what it wrote.
    """
    directory = Path(directory)
    command = [sys.executable, __file__, "--directory", directory, "--at-most", str(at_most)]
    if cache_prompt:
        command.append("--cache-prompt")
    with (directory / "null-model.log").open("w+") as log:
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True
        )
        lines = queue.Queue()
        reader = threading.Thread(target=lambda: lines.put(process.stdout.readline()), daemon=True)
        reader.start()
        try:
            try:
                line = lines.get(timeout=ready_within)
            except queue.Empty:
                line = ""
            found = dict(part.split("=", 1) for part in line.split())
            if "DURA_LLM_BASE_URL" not in found:
                log.seek(0)
                raise RuntimeError(f"the null model's server did not start: {log.read()[-2000:]}")
            yield NullServer(found["DURA_LLM_BASE_URL"], found["DURA_LLM_MODEL"], process)
        finally:
            process.stdin.close()
            try:
                process.wait(timeout=10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            reader.join(timeout=10)
            process.stdout.close()


def main(arguments=None):
    parser = argparse.ArgumentParser(description="Serves a null model on 127.0.0.1.")
    parser.add_argument("--port", type=int, default=0, help="0, the default, for any free one")
    parser.add_argument("--directory", type=Path, help="keeps the model here; default: nowhere")
    parser.add_argument("--at-most", type=float, default=3600, help="seconds; default: 3600")
    parser.add_argument("--cache-prompt", action="store_true", help="quicker, less deterministic")
    options = parser.parse_args(arguments)
    reason = missing()
    if reason:
        parser.exit(2, f"null model: {reason}\n")
    ended = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ended.set())
    threading.Thread(target=_wait_for_end_of_input, args=(ended,), daemon=True).start()
    with tempfile.TemporaryDirectory() as scratch:
        model = (options.directory or Path(scratch)) / f"null-{SEED}.gguf"
        if not model.exists():
            unfinished = model.with_suffix(f".{os.getpid()}")
            write_model(unfinished)
            unfinished.replace(model)
        server = start(model, options.port, cache_prompt=options.cache_prompt)
        print(f"DURA_LLM_BASE_URL={server.listening_address}/v1 DURA_LLM_MODEL={MODEL}", flush=True)  # noqa: T201 - whoever started it waits for this line
        # A signal may reach a thread of llama.cpp's; Python handles it when this thread wakes up.
        until = time.monotonic() + options.at_most
        while not ended.wait(0.1) and time.monotonic() < until:
            pass
    # Freeing the server waits for threads of llama.cpp's, now and then for ever.
    sys.stdout.flush()
    os._exit(0)


def _wait_for_end_of_input(ended):
    # Not through `sys.stdin`, whose lock would be held when the interpreter ends.
    while os.read(0, 4096):
        pass
    ended.set()


if __name__ == "__main__":
    main()
