"""Pruning: a directory of episodes loses those that no session has used for long."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pytest_dura.campaign.episodes.shelf import CLAIM, EPISODE, NEW
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.file_locks import is_named, lock

LEAST_AGE = 3600.0
"""s; what is younger may be of a session that still runs, which would simulate it again."""
_AGES = {"h": 3600.0, "d": 86400.0, "w": 7 * 86400.0}
_SIZES = {"M": 10**6, "G": 10**9, "T": 10**12}
_OURS = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class Pruned:
    """What was removed, and what is left.

    Args:
        removed: Episodes that were removed.
        removed_bytes: Their size.
        kept: Episodes that are left.
        kept_bytes: Their size.
    """

    removed: int
    removed_bytes: int
    kept: int
    kept_bytes: int


def prune(
    directory: Path, *, older_than: float | None = None, at_most: int | None = None
) -> Pruned:
    """Remove episodes from a directory of ``--dura-reuse``; sessions may use it meanwhile.

    A session that has looked for an episode before has it in memory or has its file open; one that
    looks for it afterwards simulates it again. No claim of a session that runs is touched, no
    symbolic link followed, and no file removed whose name we do not give.

    Args:
        directory: Where.
        older_than: Seconds: what no session has written or taken over for so long goes.
        at_most: Bytes: what was used least recently goes until no more are left, except for what is
            younger than :data:`LEAST_AGE`.

    Raises:
        ConfigurationError: If there is no such directory.
    """
    if not directory.is_dir():
        raise ConfigurationError(
            "there is no such directory of episodes",
            found=str(directory),
            expected="the directory of --dura-reuse=DIR",
        )
    now = time.time()
    found = sorted(
        (told.st_mtime, told.st_size, file)
        for file in _files(directory, EPISODE)
        if (told := _told(file)) is not None
    )
    left = sum(size for _, size, _ in found)
    removed = removed_bytes = 0
    for used, size, file in found:
        old = older_than is not None and now - used > older_than
        much = at_most is not None and left > at_most and now - used > LEAST_AGE
        if (old or much) and _removed(file):
            removed, removed_bytes, left = removed + 1, removed_bytes + size, left - size
    _remove_leftovers(directory, now)
    return Pruned(removed, removed_bytes, len(found) - removed, left)


def read_age(text: str) -> float:
    """Seconds from a text such as ``30d``, ``12h`` or ``2w``.

    Raises:
        ConfigurationError: For anything else, and for less than an hour.
    """
    number = _number(text, _AGES)
    if number is None or number < LEAST_AGE:
        raise ConfigurationError(
            "--older-than takes a time",
            key="--older-than",
            found=text,
            expected="hours, days or weeks, of an hour at least, such as 12h, 30d or 8w",
            remedy="for example --older-than=30d",
        )
    return number


def read_size(text: str) -> int:
    """Bytes from a text such as ``500M`` or ``2.5G``, in powers of ten.

    Raises:
        ConfigurationError: For anything else.
    """
    number = _number(text, _SIZES)
    if number is None:
        raise ConfigurationError(
            "--at-most takes a size",
            key="--at-most",
            found=text,
            expected="megabytes, gigabytes or terabytes, such as 500M or 2.5G",
            remedy="for example --at-most=2G",
        )
    return int(number)


def _number(text: str, units: dict[str, float] | dict[str, int]) -> float | None:
    found = re.fullmatch(r"([0-9]{1,9}(?:\.[0-9]{1,9})?)([A-Za-z])", text)
    return None if found is None or found[2] not in units else float(found[1]) * units[found[2]]


def _files(directory: Path, kind: str) -> Iterator[Path]:
    """Files of a kind that have names as we give them."""
    for file in directory.glob(f"??/*{kind}"):
        ours = _OURS.fullmatch(file.name.partition(".")[0]) and file.name[:2] == file.parent.name
        if ours and not file.parent.is_symlink() and not file.is_symlink():
            yield file


def _told(file: Path) -> os.stat_result | None:
    try:
        return file.stat()
    except OSError:  # removed in between
        return None


def _removed(file: Path) -> bool:
    try:
        file.unlink()
    except FileNotFoundError:  # by somebody else, who counts it
        return True
    except OSError:  # Windows removes no file that is open
        return False
    return True


def _remove_leftovers(directory: Path, now: float) -> None:
    """What killed processes left: half-written files, and claims that nobody holds."""
    for kind in (NEW, CLAIM):
        for file in _files(directory, kind):
            told = _told(file)
            if told is None or now - told.st_mtime <= LEAST_AGE:
                continue
            if kind == NEW:
                _removed(file)
            else:
                _remove_claim(file)


def _remove_claim(file: Path) -> None:
    with suppress(OSError):  # it is held, or gone
        handle = os.open(file, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0))
        try:
            lock(handle)
            if is_named(handle, file):
                file.unlink()
        finally:
            os.close(handle)
