"""Train the small driver from nothing: collect, learn, export.

    pip install 'pytest-dura[llm]' torch gguf
    python train.py collect                    # samples of the built-in scenarios, some minutes
    python train.py learn --minutes 40         # tokenizer and weights; curves go to curves.csv
    python train.py export                     # ../tiny-driver.gguf

What lies between goes into the directory ``--work`` (default: ``work``). A run on two cores of a
small server is enough. Results differ between machines in the last bits of the sums, and so between
trained models; what is shipped is one of them.
"""

from __future__ import annotations

import argparse
import csv
import math
import random
import re
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import corpus
import torch
from corpus import Sample
from model import Llama, Shape, export, load, save
from tokenizer import BEGIN, END, Tokenizer
from torch.nn import functional

MODEL = Path(__file__).parents[1] / "tiny-driver.gguf"
NOTHING = -100
"""Target where there is nothing to learn."""
BATCH = 32
DECISIVE = 4.0
"""Weight of the tokens that tell maneuvers and intents apart, against 1 of the others."""


@dataclass(frozen=True)
class Encoded:
    """A sample as ids; ``begins`` is where the answer does."""

    ids: list[int]
    begins: int
    maneuver: int
    """Where in ``ids`` the maneuver's first token is."""


def prompt_ids(tokenizer: Tokenizer, system: str, user: str) -> list[int]:
    """Ids of a conversation, as the model's chat template has it."""
    return [BEGIN, *tokenizer.encode(f"{system}\n{user}\n")]


def encoded(tokenizer: Tokenizer, sample: Sample) -> Encoded:
    prompt = prompt_ids(tokenizer, sample.system, sample.user)
    answer = tokenizer.encode(sample.answer)
    before = tokenizer.encode(sample.answer.partition('"maneuver":"')[0] + '"maneuver":"')
    same = 0  # the last piece before the maneuver may hold its first letters
    while same < len(before) and before[same] == answer[same]:
        same += 1
    return Encoded([*prompt, *answer, END], len(prompt), len(prompt) + same)


_ID = re.compile(r"\b(?:[VP][0-9]+|[A-Z]{2,}[A-Z0-9_]*)\b")


def renamed(sample: Sample, draws: random.Random) -> Sample:
    """The same with other ids, so that they are copied and not known by heart."""
    names: dict[str, str] = {}

    def other(match: re.Match[str]) -> str:
        old = match[0]
        if old not in names:
            while True:
                if old[1:].isdigit():
                    new = f"{old[0]}{draws.choice((draws.randint(1, 20), draws.randint(1, 999)))}"
                else:
                    letters = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
                    new = "".join(draws.choices(letters, k=draws.randint(3, 9)))
                if new not in names.values():
                    break
            names[old] = new
        return names[old]

    user = _ID.sub(other, sample.user)
    answer = _ID.sub(lambda match: names.get(match[0], match[0]), sample.answer)
    return Sample(**{**vars(sample), "user": user, "answer": answer})


def batches(
    samples: Sequence[Encoded], draws: random.Random | None = None
) -> Iterator[tuple[torch.Tensor, torch.Tensor, torch.Tensor]]:
    """Ids, targets and weights, each of shape ``(batch, tokens)``; of similar lengths together."""
    order = list(samples)
    if draws is not None:
        draws.shuffle(order)
        order.sort(key=lambda each: len(each.ids) + draws.uniform(-8, 8))
    groups = [order[at : at + BATCH] for at in range(0, len(order), BATCH)]
    if draws is not None:
        draws.shuffle(groups)
    for group in groups:
        longest = max(len(each.ids) for each in group) - 1
        ids = torch.full((len(group), longest), END)
        targets = torch.full((len(group), longest), NOTHING)
        weights = torch.ones(len(group), longest)
        for row, each in enumerate(group):
            length = len(each.ids) - 1
            ids[row, :length] = torch.tensor(each.ids[:-1])
            targets[row, each.begins - 1 : length] = torch.tensor(each.ids[each.begins :])
            weights[row, each.maneuver - 1] = DECISIVE
        yield ids, targets, weights


@torch.no_grad()
def validated(model: Llama, samples: Sequence[Encoded]) -> dict[str, float]:
    """Mean loss; share of maneuvers and of whole answers that are the teacher's.

    Where each token of the teacher's answer is the likeliest, greedy sampling gives that answer.
    """
    loss, tokens, whole, maneuvers = 0.0, 0, 0, 0
    for start in range(0, len(samples), BATCH):
        group = samples[start : start + BATCH]
        ids, targets, _ = next(batches(group))
        logits = model(ids)
        loss += float(
            functional.cross_entropy(
                logits.flatten(0, 1), targets.flatten(), ignore_index=NOTHING, reduction="sum"
            )
        )
        right = (logits.argmax(-1) == targets) | (targets == NOTHING)
        tokens += int((targets != NOTHING).sum())
        whole += int(right.all(1).sum())
        maneuvers += sum(bool(right[row, each.maneuver - 1]) for row, each in enumerate(group))
    return {
        "loss": loss / tokens, "whole": whole / len(samples), "maneuver": maneuvers / len(samples)
    }  # fmt: skip


FIGURES = ("loss", "whole", "maneuver")
PARTS = ("seeds", "scenario")
"""What validates: the scenarios of the training at other seeds, and the scenario held out."""


class Curves:
    """The file of the curves, and the mean training loss since its last row."""

    def __init__(self, path: Path, *, go_on: bool) -> None:
        self._path = path
        self._losses: list[float] = []
        if not (go_on and path.exists()):
            columns = (f"{part}_{figure}" for part in PARTS for figure in FIGURES)
            self._write(["minutes", "epoch", "step", "train_loss", *columns], "w")

    def _write(self, row: list[object], mode: str) -> None:
        with self._path.open(mode, newline="") as file:
            csv.writer(file).writerow(row)

    def add(self, loss: float) -> None:
        self._losses.append(loss)

    def row(self, minutes: float, epoch: int, step: int, figures: list[dict[str, float]]) -> None:
        mean = sum(self._losses) / len(self._losses)
        self._losses.clear()
        values = [f"{each[figure]:.4f}" for each in figures for figure in FIGURES]
        self._write([f"{minutes:.1f}", epoch, step, f"{mean:.4f}", *values], "a")
        print(f"{minutes:.1f} min, step {step}, loss {mean:.4f}, validated {values}", flush=True)


def rate_at(share: float, step: int) -> float:
    """Of the greatest learning rate: up over 100 steps, then down along a cosine."""
    return min(1.0, (step + 1) / 100) * (0.02 + 0.49 * (1 + math.cos(math.pi * min(share, 1.0))))


def tokenizer_of(work: Path, samples: Sequence[Sample]) -> Tokenizer:
    """The tokenizer of before, or a new one."""
    path = work / "tokenizer.json"
    if not path.exists():
        prompts = [f"{each.system}\n{each.user}\n" for each in samples]
        Tokenizer.train([*prompts, *(each.answer for each in samples)]).save(path)
    return Tokenizer.load(path)


def step_of(
    model: Llama, optimizer: torch.optim.Optimizer, batch: tuple[torch.Tensor, ...], rate: float
) -> float:
    """Make one step; returns the mean loss of a token."""
    ids, targets, weight = batch
    for parameters in optimizer.param_groups:
        parameters["lr"] = rate
    at = targets != NOTHING
    losses = functional.cross_entropy(model(ids, at), targets[at], reduction="none")
    loss = (losses * weight[at]).sum() / weight[at].sum()
    optimizer.zero_grad(set_to_none=True)
    loss.backward()
    torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
    optimizer.step()
    return float(losses.detach().mean())


def learn(options: argparse.Namespace) -> None:
    """Train for some minutes; writes tokenizer, weights and curves."""
    torch.manual_seed(0)
    torch.set_num_threads(options.threads)
    draws = random.Random(0)  # noqa: S311 - no secret
    work: Path = options.work
    samples = [sample for file in sorted(work.glob("train*.jsonl")) for sample in corpus.read(file)]
    if not samples:
        sys.exit(f"no samples in {work}: collect them first")
    tokenizer = tokenizer_of(work, samples)
    parts = []
    for name in PARTS:
        held_out = corpus.read(work / f"{name}.jsonl")
        chosen = draws.sample(held_out, min(len(held_out), 256))
        parts.append([encoded(tokenizer, each) for each in chosen])
    weights = work / "weights.pt"
    shape = Shape(len(tokenizer), options.width, options.layers, options.heads, options.inner)
    model = load(weights) if options.go_on else Llama(shape)
    print(f"{len(samples)} samples, {len(tokenizer)} pieces, {model.size} parameters", flush=True)
    optimizer = torch.optim.AdamW(model.parameters(), betas=(0.9, 0.98), weight_decay=0.05)
    curves = Curves(work / "curves.csv", go_on=options.go_on)
    begun, step, epoch, share = time.monotonic(), 0, 0, 0.0
    while share < 1.0:
        epoch += 1
        renewed = [encoded(tokenizer, renamed(each, draws)) for each in samples]
        for batch in batches(renewed, draws):
            share = (time.monotonic() - begun) / 60 / options.minutes
            curves.add(step_of(model, optimizer, batch, options.rate * rate_at(share, step)))
            step += 1
            if step % options.every == 0 or share >= 1.0:
                figures = [validated(model, part) for part in parts]
                curves.row(share * options.minutes, epoch, step, figures)
                save(weights, model)
            if share >= 1.0:
                break


def collect(options: argparse.Namespace) -> None:
    """Write the samples for training and validation."""
    work: Path = options.work
    work.mkdir(parents=True, exist_ok=True)
    parts = (
        ("train.jsonl", corpus.SEED, options.runs, False),
        ("seeds.jsonl", corpus.HELD_OUT_SEED, 2, False),
        ("scenario.jsonl", corpus.HELD_OUT_SEED, 4, True),
    )
    for name, seed, runs, held_out in parts:
        count = corpus.write(work / name, seed, runs, held_out=held_out)
        print(f"{name}: {count} samples", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("collect", "learn", "export"))
    parser.add_argument("--work", type=Path, default=Path("work"), help="what lies between")
    parser.add_argument("--runs", type=int, default=30, help="of each scenario and policy")
    parser.add_argument("--minutes", type=float, default=40.0, help="of training")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--rate", type=float, default=2e-3, help="greatest learning rate")
    parser.add_argument("--every", type=int, default=200, help="steps between two validations")
    parser.add_argument("--width", type=int, default=128)
    parser.add_argument("--layers", type=int, default=4)
    parser.add_argument("--heads", type=int, default=4)
    parser.add_argument("--inner", type=int, default=320)
    parser.add_argument("--go-on", action="store_true", help="with the weights of before")
    options = parser.parse_args()
    if options.what == "collect":
        collect(options)
    elif options.what == "learn":
        learn(options)
    else:
        model = load(options.work / "weights.pt")
        export(MODEL, model, Tokenizer.load(options.work / "tokenizer.json"))
        size = MODEL.stat().st_size / 1e6
        print(f"{MODEL.name}: {model.size} parameters, {size:.1f} MB")


if __name__ == "__main__":
    sys.exit(main())
