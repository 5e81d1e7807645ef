"""The episode players that the page holds: few, and no more than some megabytes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import describe_error
from pytest_dura.evidence.bundle.manifest import file_entry
from pytest_dura.evidence.formats.report.anchors import player_anchor
from pytest_dura.evidence.formats.report.folding import Key
from pytest_dura.evidence.formats.report.gathering import Listed
from pytest_dura.evidence.record.session_record import SessionRecord

if TYPE_CHECKING:
    from markupsafe import Markup

Data = Mapping[str, Any]

MAX_PLAYERS = 12
MAX_CHARACTERS = 6_000_000


@dataclass
class Players:
    """What is embedded of traces, and what could not be.

    Args:
        rows: In the page's order: the episode with ``anchor``, ``packed`` (the player's text, or
            ``None``) and ``problem``.
        shown: Id and component of those with a player.
        script: The player's own.
        style: The player's own.
    """

    rows: list[Data] = field(default_factory=list)
    shown: list[Key] = field(default_factory=list)
    script: str = ""
    style: str = ""


def embedded(record: SessionRecord, candidates: Sequence[Listed]) -> Players:
    """Players of the first episodes whose traces can be read, up to the bounds.

    Args:
        record: The record, in whose directory the traces lie.
        candidates: Episodes with a trace, those that show most first.
    """
    players = Players()
    room = MAX_CHARACTERS
    for one in candidates:
        if len(players.shown) == MAX_PLAYERS:
            break
        if one.key in players.shown:
            continue
        packed, problem = None, ""
        try:
            packed = _packed(record, one)
        except Exception as error:  # told in the trace's place
            problem = describe_error(error)
        if packed is not None and len(packed) > room:
            continue
        told = {**one.episode, "violates": one.violates, "problem": problem}
        told["packed"] = None if packed is None else _plain_base64(packed)
        players.rows.append({**told, "anchor": player_anchor(*one.key)})
        if packed is not None:
            room -= len(packed)
            players.shown.append(one.key)
    if players.shown:
        from pytest_dura.evidence.player import assets

        players.script, players.style = assets()
    return players


def _packed(record: SessionRecord, one: Listed) -> str:
    """The player's text of an episode's trace.

    Raises:
        ValueError: If the file is not the one that was written, or lies outside the bundle.
    """
    from pytest_dura.evidence.player import packed, player_data
    from pytest_dura.evidence.traces.mcap_file import read_trace

    file = _inside(record.directory, one.episode["trace"]["file"])
    digest = file_entry(file)["sha256"]
    if digest != one.episode["trace"]["sha256"]:
        raise ValueError(f"its SHA-256 is {digest[:12]}..., and the record says another")
    return packed(player_data(read_trace(file), _judged(record, one)))


def _judged(record: SessionRecord, one: Listed) -> list[Data]:
    """What the record says of this very episode, its violations first."""
    violated: list[Data] = []
    others: list[Data] = []
    for verdict in record["verdicts"]:
        case = verdict["case"], verdict["component"]
        if case != (one.episode["case"], one.episode["component"]):
            continue
        told = {"requirement": verdict["requirement"], "check": verdict["check"]}
        against = [
            found for found in verdict["counterexamples"] if found["episode"] == one.episode["id"]
        ]
        if against and one.violates:
            told |= {"time": against[0]["time"], "margin": against[0]["margin"]}
            note = "" if against[0]["valid"] else "without effect of the fault"
            violated.append({**told, "verdict": "violated", "note": note})
        else:
            word, note = _unviolated(verdict, one.episode)
            others.append({**told, "verdict": word, "note": note})
    return violated + others


def _unviolated(verdict: Data, episode: Data) -> tuple[str, str]:
    """What a verdict says of an episode that is none of its counterexamples, and a note on it.

    The record names single episodes where they violate; of others it tells the sum.
    """
    # Another requirement on the case may have needed more runs than this one looked at.
    beyond = verdict["check"] and episode["run"] >= verdict["run"]
    if not episode["planned"] or beyond:
        return "not judged", "the verdict rests on other runs"
    if episode["validity"] != "valid":
        return episode["validity"], ""
    if episode["id"] in verdict["open"]:
        return "open", "the episode ended before it was decided"
    if verdict["pairs"] is not None:
        return "not violated", "judged on pairs of runs"
    if verdict["invalid"] or verdict["missing"] or verdict["saved"]:
        return "not violated", "or not decided: of some of its runs the verdict knows no more"
    return "satisfied", ""


def _plain_base64(text: str) -> Markup:
    """The player's text for a script element, which is not escaped.

    Raises:
        ValueError: If it holds anything but letters, digits and ``+/=``.
    """
    from markupsafe import Markup

    if not re.fullmatch(r"[A-Za-z0-9+/=]*", text):
        raise ValueError("the player's text is not base64")
    return Markup(text)  # noqa: S704 - it was just looked at


def _inside(directory: Path, name: str) -> Path:
    file = (directory / name).resolve()
    if not file.is_relative_to(directory.resolve()):
        raise ValueError("the file lies outside the evidence")
    return file
