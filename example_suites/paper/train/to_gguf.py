"""Write an adapter of peft as a file for llama.cpp.

pip install gguf safetensors
python to_gguf.py work/adapter trained.gguf
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from base_model import PROJECTIONS, pairs_of_heads

NAME = "SmolLM2-135M-Instruct LoRA, planner of pytest-dura"


def converted(name: str, values: np.ndarray) -> tuple[str, np.ndarray]:
    """Name and numbers of a tensor as llama.cpp has them.

    Args:
        name: Such as ``base_model.model.model.layers.0.self_attn.q_proj.lora_A.weight``.
        values: Its numbers.
    """
    _, _, inside = name.partition(".layers.")
    layer, group, projection, factor, _ = inside.split(".")
    kind = PROJECTIONS[f"{group}.{projection}"]
    values = np.ascontiguousarray(values.astype(np.float16))
    if factor == "lora_B" and kind in ("attn_q", "attn_k"):
        values = pairs_of_heads(values)
    return f"blk.{layer}.{kind}.weight.{factor.lower()}", values


def write(path: Path, tensors: Mapping[str, np.ndarray], alpha: float) -> None:
    """Write the file.

    Args:
        path: To write.
        tensors: Of peft, by name.
        alpha: Of the adapter: it is scaled by ``alpha`` over its rank.
    """
    import gguf

    writer = gguf.GGUFWriter(path, "llama")
    writer.add_type("adapter")
    writer.add_string("adapter.type", "lora")
    writer.add_float32("adapter.lora.alpha", alpha)
    writer.add_name(NAME)
    writer.add_license("apache-2.0")
    for name, values in tensors.items():
        writer.add_tensor(*converted(name, values))
    writer.write_header_to_file()
    writer.write_kv_data_to_file()
    writer.write_tensors_to_file()
    writer.close()


def write_adapter(folder: Path, path: Path) -> None:
    """Write the adapter that peft saved in a folder."""
    from safetensors.numpy import load_file

    alpha = json.loads((folder / "adapter_config.json").read_text())["lora_alpha"]
    write(path, load_file(folder / "adapter_model.safetensors"), float(alpha))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("adapter", type=Path, help="folder that train.py or peft wrote")
    parser.add_argument("to", type=Path, help="file to write")
    options = parser.parse_args()
    write_adapter(options.adapter, options.to)
    print(f"{options.to}: {options.to.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
