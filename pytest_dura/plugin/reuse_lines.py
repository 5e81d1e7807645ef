"""What the terminal says of episodes of earlier sessions, and how an interrupted one goes on."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Any

from pytest_dura.plugin.tables import counted

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from pytest_dura.evidence.record.session_record import SessionRecord
    from pytest_dura.plugin.session import DuraSession

_MOST = 8
"""Reasons that are told."""


def reuse_lines(record: SessionRecord) -> Iterator[str]:
    """How many episodes were taken over, how many were simulated, and why some of them again."""
    if record["reuse"]["mode"] != "none":
        yield from _lines(record["reuse"], record["totals"]["episodes"], "episode")


def searched_lines(record: SessionRecord) -> Iterator[str]:
    """The same of what searches simulated, and why something could not be shared."""
    searched = record["reuse"]["searched"]
    if searched is not None and searched["simulations"]:
        yield from _lines(searched, searched["simulations"], "run", " of searches")
    yield from record["reuse"]["problems"]


def _lines(reuse: Mapping[str, Any], count: int, one: str, whose: str = "") -> Iterator[str]:
    from pytest_dura.evidence.record.reuse import why_again

    taken, sessions = reuse["taken_over"], len(reuse["sessions"])
    from_where = f" from {counted(sessions, 'earlier session')}" if taken else ""
    yield f"{counted(taken, one)}{whose} taken over{from_where}, {count - taken} simulated"
    outdated = sorted(reuse["outdated"], key=lambda each: -each["episodes"])
    for each in outdated[:_MOST]:
        again = f"{counted(each['episodes'], one)}{whose} simulated again"
        yield f"{again}: {why_again(each['changed'])}"
    if len(outdated) > _MOST:
        rest = sum(each["episodes"] for each in outdated[_MOST:])
        yield f"{counted(rest, one)}{whose} simulated again for other reasons: see the record"


def resume_lines(session: DuraSession) -> Iterator[str]:
    """How a session that was not whole goes on, if anything of it was kept."""
    if session.shared.is_whole or not session.shared.shelf.count():
        return
    if session.shared.mode == "reuse":
        yield "to go on, give the same command again: its episodes are kept"
    else:
        yield f"to go on: {_resuming(session)}"


def _resuming(session: DuraSession) -> str:
    arguments: list[Any] = [*session.config.invocation_params.args]
    option = "--dura-resume"
    if option not in arguments:
        arguments.append(option)
    return shlex.join(["pytest", *map(str, arguments)])
