"""The verdicts in the terminal, and why those that are not "supported" are not."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from pytest_dura.plugin.commands import replay_command, rerun_command
from pytest_dura.plugin.fault_lines import chain_line
from pytest_dura.plugin.tables import WIDTH, Data, counted

if TYPE_CHECKING:
    from pytest_dura.plugin.session import DuraSession

TOGETHER = "\N{NO-BREAK SPACE}"
"""Keeps a requirement and its margin on one line, and is shown as a space."""
COLOURS = {"supported": {"green": True}, "violated": {"red": True}, "undecided": {"yellow": True}}


def show_verdicts(session: DuraSession, terminal: Any, record: Data) -> None:
    """Every verdict with its figures, and then each failure with what helps to mend it."""
    verdicts = record["verdicts"]
    if not verdicts:
        return
    terminal.line("")
    same: dict[tuple[str, ...], list[Data]] = {}
    for verdict in verdicts:
        where = f"{verdict['case']} ({verdict['component']})"
        same.setdefault((verdict["verdict"], where, _counts(verdict)), []).append(verdict)
    for (word, where, counts), group in same.items():
        terminal.write(f"{word:<9}", **COLOURS[word])
        terminal.line(f"  {where}")
        terminal.line(f"{'':<11}{counts}")
        names = ", ".join(dict.fromkeys(map(_with_margin, group)))
        for line in textwrap.wrap(names, WIDTH - 11, break_on_hyphens=False):
            terminal.line(f"{'':<11}{line.replace(TOGETHER, ' ')}")
    terminal.line(f"{'':<11}(behind each requirement: its least margin, in the check's unit)")
    alike: dict[tuple[str, ...], list[Data]] = {}
    for verdict in verdicts:
        if verdict["verdict"] != "supported":
            # What is undecided for one reason is told once for all requirements of a case.
            cause = verdict["reason"], (verdict["spoilt"] or {}).get("detail", "")
            apart = (verdict["requirement"],) if verdict["verdict"] == "violated" else cause
            alike.setdefault((verdict["case"], verdict["component"], *apart), []).append(verdict)
    for group in alike.values():
        _show_failure(session, terminal, record, group)


def _counts(verdict: Data) -> str:
    """The figures that the verdict rests on."""
    counts = f"n = {verdict['episodes']}, {counted(verdict['violations'], 'violation')}"
    if verdict["pairs"]:
        counts = f"pairs without {verdict['pairs']['without']}: {counts}"
    bound = verdict["bound"]
    if bound["upper"] is not None:
        counts += f", rate <= {bound['upper']:.2g} at {bound['confidence']:g}"
    counts += f", {verdict['method']}"
    if verdict["saved"]:
        counts += f", {verdict['saved']} of {verdict['planned']} runs saved"
    waiver = f" [{verdict['waiver']['kind']}]" if verdict["waiver"] else ""
    return counts + waiver


def _with_margin(verdict: Data) -> str:
    """The requirement, its least margin, and how many episodes satisfied it vacuously."""
    told = [] if verdict["margin"] is None else [f"{verdict['margin']:.3g}"]
    if verdict["vacuous"]:
        told.append(f"{verdict['vacuous']} vacuous")
    name = str(verdict["requirement"])
    return f"{name}{TOGETHER}({f',{TOGETHER}'.join(told)})".replace(" ", TOGETHER) if told else name


def _show_failure(
    session: DuraSession, terminal: Any, record: Data, verdicts: Sequence[Data]
) -> None:
    first = verdicts[0]
    names = ", ".join(dict.fromkeys(one["requirement"] for one in verdicts))
    terminal.line("")
    terminal.line(
        f"{first['verdict']}: {names} on {first['case']} ({first['component']})",
        **COLOURS[first["verdict"]],
    )
    for line in textwrap.wrap(first["reason"], WIDTH - 2):
        terminal.line(f"  {line}")
    check = first["check"] or _check_of(record, first["requirement"])
    if check and len(verdicts) == 1 and check != first["requirement"]:
        terminal.line(f"  check:  {check}")
    _show_episode(session, terminal, record, first)
    items = list(dict.fromkeys(item for one in verdicts for item in one["item"].split(", ")))
    if len(items) > 1 and all(item.startswith(f"{first['case']}::") for item in items):
        items = [first["case"]]
    for item in items:
        terminal.line(f"  rerun:  {rerun_command(session, item)}")


def _check_of(record: Data, requirement: str) -> str:
    return next((one["check"] for one in record["requirements"] if one["id"] == requirement), "")


def _show_episode(session: DuraSession, terminal: Any, record: Data, verdict: Data) -> None:
    """The worst episode, or one that spoilt the campaign, and how to see it again."""
    if verdict["counterexamples"]:
        from pytest_dura.campaign.reasons import describe_counterexample

        episode = verdict["counterexamples"][0]["episode"]
        terminal.line(f"  worst:  {describe_counterexample(verdict['counterexamples'][0])}")
        # What ended the episode before its time, if anything did.
        for event in _episode(record, episode, verdict["component"])["events"]:
            if event["kind"] == "critical":
                terminal.line(f"  event:  at t = {event['time']:.2f} s {event['detail']}")
    elif verdict["spoilt"] is not None:
        episode, told = verdict["spoilt"]["episode"], str(verdict["spoilt"]["detail"])
        if verdict["spoilt"]["verdict"] == "invalid" and not told.startswith("invalid: "):
            told = f"invalid: {told}"
        terminal.line(f"  {told}")
    else:
        return
    for fault in _episode(record, episode, verdict["component"])["faults"]:
        first, *rest = textwrap.wrap(chain_line(fault), WIDTH - 12, break_on_hyphens=False)
        terminal.line(f"  fault:  {first}")
        for line in rest:
            terminal.line(f"            {line}")
    terminal.line(f"  replay: {replay_command(session, episode)}")


def _episode(record: Data, name: str, component: str) -> Data:
    """The episode that a verdict on a component names: not another one's, nor one run by hand."""
    found = [
        one for one in record["episodes"] if (one["id"], one["component"]) == (name, component)
    ]
    found.sort(key=lambda one: not one["planned"])
    return found[0] if found else {"faults": [], "events": []}
