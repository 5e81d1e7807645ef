"""A Llama in plain torch, as llama.cpp runs it, and its file.

RMSNorm before attention and feed-forward, rotary positions on neighbouring pairs of numbers (which
is llama.cpp's own order, so nothing is permuted on export), SwiGLU, no biases, input and output
embeddings apart.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from tokenizer import BEGIN, BYTES, END, UNKNOWN, Tokenizer
from torch import Tensor, nn
from torch.nn import functional

NAME = "tiny-driver"
TEMPLATE = "{% for message in messages %}{{ message['content'] }}\n{% endfor %}"
"""Of a conversation: each message on lines of its own; the answer follows."""


@dataclass(frozen=True)
class Shape:
    """Sizes of a model."""

    vocabulary: int
    width: int = 192
    layers: int = 5
    heads: int = 4
    inner: int = 512
    context: int = 2048
    epsilon: float = 1e-5
    base: float = 10_000.0

    @property
    def head(self) -> int:
        """Numbers of one head."""
        return self.width // self.heads


class Block(nn.Module):
    """A layer: attention, then feed-forward, each added to what it was given."""

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        self.shape = shape
        self.attention_norm = nn.RMSNorm(shape.width, eps=shape.epsilon)
        self.q, self.k, self.v, self.o = (
            nn.Linear(shape.width, shape.width, bias=False) for _ in range(4)
        )
        self.ffn_norm = nn.RMSNorm(shape.width, eps=shape.epsilon)
        self.gate = nn.Linear(shape.width, shape.inner, bias=False)
        self.up = nn.Linear(shape.width, shape.inner, bias=False)
        self.down = nn.Linear(shape.inner, shape.width, bias=False)

    def forward(self, x: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
        """The next state of each token, shape ``(batch, tokens, width)``."""
        batch, tokens, _ = x.shape
        y = self.attention_norm(x)

        def heads(projected: Tensor) -> Tensor:
            return projected.view(batch, tokens, self.shape.heads, self.shape.head).transpose(1, 2)

        q, k, v = (
            rotated(heads(self.q(y)), cos, sin),
            rotated(heads(self.k(y)), cos, sin),
            self.v(y),
        )
        y = functional.scaled_dot_product_attention(q, k, heads(v), is_causal=True)
        x = x + self.o(y.transpose(1, 2).reshape(batch, tokens, -1))
        y = self.ffn_norm(x)
        return x + self.down(functional.silu(self.gate(y)) * self.up(y))


def rotated(x: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """Turn the pairs ``(0, 1), (2, 3), ...`` of each head by their angles."""
    even, odd = x[..., 0::2], x[..., 1::2]
    return torch.stack((even * cos - odd * sin, even * sin + odd * cos), dim=-1).flatten(-2)


class Llama(nn.Module):
    """The model: ids of tokens to logits of the next."""

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        self.shape = shape
        self.embedding = nn.Embedding(shape.vocabulary, shape.width)
        self.blocks = nn.ModuleList(Block(shape) for _ in range(shape.layers))
        self.norm = nn.RMSNorm(shape.width, eps=shape.epsilon)
        self.output = nn.Linear(shape.width, shape.vocabulary, bias=False)
        for weights in self.parameters():
            if weights.dim() == 2:
                nn.init.normal_(weights, std=0.03)
        for block in self.blocks:
            for last in (block.o, block.down):
                nn.init.normal_(last.weight, std=0.03 / (2 * shape.layers) ** 0.5)

    def forward(self, ids: Tensor, at: Tensor | None = None) -> Tensor:
        """Logits, shape ``(batch, tokens, vocabulary)``; or of the places where ``at`` is true.

        Args:
            ids: Shape ``(batch, tokens)``.
            at: The same shape.
        """
        half = torch.arange(0, self.shape.head, 2) / self.shape.head
        angles = torch.arange(ids.shape[1])[:, None] * self.shape.base**-half
        cos, sin = angles.cos(), angles.sin()
        x = self.embedding(ids)
        for block in self.blocks:
            x = block(x, cos, sin)
        x = self.norm(x)
        return self.output(x if at is None else x[at])

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return sum(weights.numel() for weights in self.parameters())


def save(path: Path, model: Llama) -> None:
    """Write weights and sizes, for further training."""
    torch.save({"shape": asdict(model.shape), "weights": model.state_dict()}, path)


def load(path: Path) -> Llama:
    """Read what :func:`save` wrote."""
    data = torch.load(path, weights_only=True)
    model = Llama(Shape(**data["shape"]))
    model.load_state_dict(data["weights"])
    return model


def _parts(model: Llama) -> dict[str, nn.Module]:
    """The modules with weights, by llama.cpp's names."""
    names: dict[str, nn.Module] = {
        "token_embd": model.embedding, "output_norm": model.norm, "output": model.output
    }  # fmt: skip
    for number, block in enumerate(model.blocks):
        parts = {
            "attn_norm": block.attention_norm, "attn_q": block.q, "attn_k": block.k,
            "attn_v": block.v, "attn_output": block.o, "ffn_norm": block.ffn_norm,
            "ffn_gate": block.gate, "ffn_up": block.up, "ffn_down": block.down,
        }  # fmt: skip
        names |= {f"blk.{number}.{name}": part for name, part in parts.items()}
    return names


def export(path: Path, model: Llama, tokenizer: Tokenizer) -> None:
    """Write a GGUF file for llama.cpp: matrices in 16 bits, norms in 32."""
    import gguf
    import numpy as np

    shape = model.shape
    writer = gguf.GGUFWriter(path, "llama")
    writer.add_name(NAME)
    writer.add_context_length(shape.context)
    writer.add_embedding_length(shape.width)
    writer.add_block_count(shape.layers)
    writer.add_feed_forward_length(shape.inner)
    writer.add_head_count(shape.heads)
    writer.add_head_count_kv(shape.heads)
    writer.add_rope_dimension_count(shape.head)
    writer.add_rope_freq_base(shape.base)
    writer.add_layer_norm_rms_eps(shape.epsilon)
    writer.add_vocab_size(shape.vocabulary)
    writer.add_file_type(gguf.LlamaFileType.MOSTLY_F16)
    kinds = gguf.TokenType
    control = [kinds.UNKNOWN, kinds.CONTROL, kinds.CONTROL]
    writer.add_tokenizer_model("llama")
    writer.add_token_list([token.encode() for token in tokenizer.tokens])
    writer.add_token_scores(tokenizer.scores)
    writer.add_token_types(
        [*control, *[kinds.BYTE] * 256, *[kinds.NORMAL] * (len(tokenizer) - BYTES - 256)]
    )
    writer.add_unk_token_id(UNKNOWN)
    writer.add_bos_token_id(BEGIN)
    writer.add_eos_token_id(END)
    writer.add_add_bos_token(True)
    writer.add_add_eos_token(False)
    writer.add_add_space_prefix(False)
    writer.add_chat_template(TEMPLATE)
    for name, part in _parts(model).items():
        weights = part.weight.detach().float().numpy()
        kind = np.float16 if weights.ndim == 2 else np.float32
        writer.add_tensor(f"{name}.weight", weights.astype(kind))
    writer.write_header_to_file()
    writer.write_kv_data_to_file()
    writer.write_tensors_to_file()
    writer.close()


def read_gguf(path: Path) -> tuple[Llama, Tokenizer]:
    """Read what :func:`export` wrote: the model as llama.cpp has it, in 32 bits."""
    import gguf

    reader = gguf.GGUFReader(path)

    def value(name: str):
        return reader.get_field(name).contents()

    tokens = value("tokenizer.ggml.tokens")
    shape = Shape(
        vocabulary=len(tokens),
        width=value("llama.embedding_length"),
        layers=value("llama.block_count"),
        heads=value("llama.attention.head_count"),
        inner=value("llama.feed_forward_length"),
        context=value("llama.context_length"),
        base=value("llama.rope.freq_base"),
    )
    model = Llama(shape)
    tensors = {each.name: torch.tensor(each.data.astype("float32")) for each in reader.tensors}
    with torch.no_grad():
        for name, part in _parts(model).items():
            part.weight.copy_(tensors[f"{name}.weight"])
    return model, Tokenizer(tokens[BYTES + 256 :])
