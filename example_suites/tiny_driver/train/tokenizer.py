"""A tokenizer of some hundred pieces, as llama.cpp's tokenizer ``llama`` works.

Of two neighbouring pieces whose joint text is a piece, those with the highest score are joined
first, the leftmost of equal ones; a character that is no piece becomes its bytes. No piece crosses
a space or a line's end. Numbers below 100 behind a space are a piece each, so that a small model
can look them up, and so are tenths. Other digits and capital letters stand alone, so that it can
copy any id.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path

SPACE = "\u2581"
"""How a tokenizer of this kind writes a space."""
UNKNOWN, BEGIN, END = 0, 1, 2
CONTROLS = ["<unk>", "<s>", "</s>"]
BYTES = len(CONTROLS)
_WORDS = re.compile(
    rf"\n|{SPACE}[0-9]+|[0-9]|\.[0-9]|{SPACE}?[A-Z]|{SPACE}?(?:(?!\.[0-9])[^A-Z0-9\n{SPACE}])+|{SPACE}"
)


class Tokenizer:
    """Texts to ids of pieces, and back.

    Args:
        pieces: Texts of the pieces behind controls and bytes, the first to be joined first.
    """

    def __init__(self, pieces: Sequence[str]) -> None:
        self.pieces = list(pieces)
        self.tokens = [*CONTROLS, *(f"<0x{byte:02X}>" for byte in range(256)), *pieces]
        self._ids = {piece: BYTES + 256 + at for at, piece in enumerate(pieces)}
        self._known: dict[str, list[int]] = {}

    def __len__(self) -> int:
        return len(self.tokens)

    @property
    def scores(self) -> list[float]:
        """One per token: the earlier a piece, the higher."""
        return [0.0] * (BYTES + 256) + [-float(at) for at in range(len(self.pieces))]

    def encode(self, text: str) -> list[int]:
        """Ids of a text, without controls."""
        ids: list[int] = []
        for word in _WORDS.findall(text.replace(" ", SPACE)):
            if word not in self._known:
                self._known[word] = self._join(word)
            ids += self._known[word]
        return ids

    def _join(self, word: str) -> list[int]:
        parts: list[str] = list(word)
        while True:
            ranks = [
                (self._ids[joint], at)
                for at, joint in enumerate(map(str.__add__, parts, parts[1:]))
                if joint in self._ids
            ]
            if not ranks:
                break
            _, at = min(ranks)
            parts[at : at + 2] = [parts[at] + parts[at + 1]]
        ids: list[int] = []
        for part in parts:
            if part in self._ids:
                ids.append(self._ids[part])
            else:
                ids += [BYTES + byte for byte in part.replace(SPACE, " ").encode()]
        return ids

    def decode(self, ids: Iterable[int]) -> str:
        """The text of ids; controls are left out."""
        data = b""
        for each in ids:
            if BYTES <= each < BYTES + 256:
                data += bytes([each - BYTES])
            elif each >= BYTES + 256:
                data += self.tokens[each].replace(SPACE, " ").encode()
        return data.decode(errors="replace")

    @classmethod
    def train(cls, texts: Iterable[str], most: int = 1000) -> Tokenizer:
        """Learn pieces: the most frequent pair of neighbours is joined, again and again."""
        counts = Counter(
            word for text in texts for word in _WORDS.findall(text.replace(" ", SPACE))
        )
        numbers = [*(f"{SPACE}{n}" for n in range(100)), *(f".{n}" for n in range(10))]
        capitals = [f"{SPACE}{letter}" for letter in "ABCDEFGHIJKLMNOPQRSTUVWXYZ"]
        characters = [*capitals, *(chr(code) for code in range(33, 127)), SPACE, "\n"]
        words = {
            word: list(word)
            for word in counts
            if not any(letter.isdigit() or letter.isupper() for letter in word)
        }
        joined: list[str] = []
        room = most - BYTES - 256 - len(numbers) - len(characters)
        while len(joined) < room:
            pairs: Counter[tuple[str, str]] = Counter()
            for word, parts in words.items():
                for pair in pairwise(parts):
                    pairs[pair] += counts[word]
            if not pairs:
                break
            (first, second), count = max(pairs.items(), key=lambda item: (item[1], item[0]))
            if count < 2:
                break
            joined.append(first + second)
            for parts in words.values():
                at = 0
                while at < len(parts) - 1:
                    if parts[at] == first and parts[at + 1] == second:
                        parts[at : at + 2] = [first + second]
                    at += 1
        # A piece can come of two different pairs; the first is the one that counts.
        return cls(list(dict.fromkeys([*numbers, *joined, *characters])))

    def save(self, path: Path) -> None:
        """Write the pieces."""
        path.write_text(json.dumps(self.pieces, ensure_ascii=False, indent=0) + "\n")

    @classmethod
    def load(cls, path: Path) -> Tokenizer:
        """Read the pieces."""
        return cls(json.loads(path.read_text()))
