"""The verdicts in the terminal, and why those that are not "supported" are not."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pytest_dura.evidence.formats.stated import also_without, besides, by_assertion, event_line
from pytest_dura.evidence.text import name, one_line
from pytest_dura.plugin.commands import replay_command, rerun_command
from pytest_dura.plugin.fault_lines import chain_line
from pytest_dura.plugin.shortening import MOST, RANK, left_out, worst
from pytest_dura.plugin.tables import WIDTH, Data, counted
from pytest_dura.requirements.verdicts.situations import SITUATIONS

if TYPE_CHECKING:
    from pytest_dura.evidence.record.session_record import SessionRecord
    from pytest_dura.plugin.session import DuraSession

LONGEST = 2000
"""Characters of a text that is told in several lines."""
TOGETHER = "\N{NO-BREAK SPACE}"
"""Keeps a requirement and its margin on one line, and is shown as a space."""
COLOURS = {"supported": {"green": True}, "violated": {"red": True}, "undecided": {"yellow": True}}


def show_verdicts(session: DuraSession, terminal: Any, record: SessionRecord) -> None:
    """Every verdict with its figures, and then each failure with what helps to mend it."""
    verdicts = record["verdicts"]
    if not verdicts:
        return
    terminal.line("")
    most = None if session.config.option.verbose > 0 else MOST
    shown = worst(verdicts, [RANK[one["verdict"]] for one in verdicts], most=most)
    kept = {id(one) for one in shown}
    same: dict[tuple[str, ...], list[Data]] = {}
    for verdict in shown:
        told = verdict["verdict"], _where(verdict), _counts(verdict), *_rests_on(verdict)
        same.setdefault(told, []).append(verdict)
    for told, group in same.items():
        _show_alike(terminal, told, group)
    for line in left_out(one["verdict"] for one in verdicts if id(one) not in kept):
        terminal.line(line)
    terminal.line(f"{'':<11}(behind each requirement: its least margin, in the check's unit)")
    alike: dict[tuple[str, ...], list[Data]] = {}
    for verdict in shown:
        if verdict["verdict"] != "supported":
            # What is undecided for one reason is told once for all requirements of a case.
            cause = verdict["reason"], (verdict["spoilt"] or {}).get("detail", "")
            apart = (verdict["requirement"],) if verdict["verdict"] == "violated" else cause
            alike.setdefault((verdict["case"], verdict["component"], *apart), []).append(verdict)
    episodes = _named(record, [group[0] for group in alike.values()])
    checks = {one["id"]: one["check"] for one in record["requirements"]}
    for group in alike.values():
        check = str(group[0]["check"] or checks.get(group[0]["requirement"], ""))
        _show_failure(session, terminal, check, group, episodes)


def _show_alike(terminal: Any, told: tuple[str, ...], verdicts: Sequence[Data]) -> None:
    """Verdicts of a case that differ by their requirement and margin alone."""
    word, where, counts, *rests_on = told
    terminal.write(f"{word:<9}", **COLOURS[word])
    terminal.line(f"  {where}")
    terminal.line(f"{'':<11}{counts}")
    names = ", ".join(dict.fromkeys(map(_with_margin, verdicts)))
    for line in textwrap.wrap(names, WIDTH - 11, break_on_hyphens=False):
        terminal.line(f"{'':<11}{line.replace(TOGETHER, ' ')}")
    for sentence in rests_on:
        for line in textwrap.wrap(sentence, WIDTH - 11, subsequent_indent="  "):
            terminal.line(f"{'':<11}{line}")


def _counts(verdict: Data) -> str:
    """The figures that the verdict rests on."""
    violations = counted(verdict["violations"], "violation") + also_without(verdict)
    counts = f"n = {verdict['episodes']}, {violations}"
    if verdict["pairs"]:
        counts = f"pairs without {verdict['pairs']['without']}: {counts}"
    left = [told for told in besides(verdict) if not told.endswith("vacuous")]
    counts = ", ".join([counts, *left])
    bound = verdict["bound"]
    if bound["upper"] is not None:
        counts += f", rate <= {bound['upper']:.2g} at {bound['confidence']:g}"
    if verdict["situation"] is not None:
        counts += f", {SITUATIONS[verdict['situation']]}"
    counts += f", {verdict['method']}"
    if verdict["saved"]:
        counts += f", {verdict['saved']} of {verdict['planned']} runs saved"
    waiver = f" [{verdict['waiver']['kind']}]" if verdict["waiver"] else ""
    return counts + waiver


def _rests_on(verdict: Data) -> list[str]:
    """That assertions decided it, and what they looked at; what failed is shown further below."""
    told = [one_line(one, LONGEST) for one in by_assertion(verdict)]
    return [one for one in told if not one.startswith(("failed: ", "by its check"))]


def _with_margin(verdict: Data) -> str:
    """The requirement, its least margin, and how many episodes satisfied it vacuously."""
    told = [] if verdict["margin"] is None else [f"{verdict['margin']:.3g}"]
    if verdict["vacuous"]:
        told.append(f"{verdict['vacuous']} vacuous")
    shown = name(verdict["requirement"])
    if not told:
        return shown
    return f"{shown}{TOGETHER}({f',{TOGETHER}'.join(told)})".replace(" ", TOGETHER)


def _where(verdict: Data) -> str:
    return f"{name(verdict['case'])} ({name(verdict['component'])})"


def _show_failure(
    session: DuraSession,
    terminal: Any,
    check: str,
    verdicts: Sequence[Data],
    episodes: Mapping[tuple[str, str], Data],
) -> None:
    first = verdicts[0]
    names = ", ".join(dict.fromkeys(name(one["requirement"]) for one in verdicts))
    terminal.line("")
    terminal.line(
        f"{first['verdict']}: {names} on {_where(first)}",
        **COLOURS[first["verdict"]],
    )
    for line in textwrap.wrap(one_line(first["reason"], LONGEST), WIDTH - 2):
        terminal.line(f"  {line}")
    own = first["assertion"] or {"failed": [], "by_check": 0}
    for line in by_assertion(first)[: len(own["failed"][:1])]:
        terminal.line(f"  {one_line(line, LONGEST)}")
    held = own["failed"] and not own["by_check"]  # what failed is an assertion of the test
    if check and len(verdicts) == 1 and check != first["requirement"] and not held:
        terminal.line(f"  check:  {check}")
    _show_episode(session, terminal, first, episodes)
    items = list(dict.fromkeys(item for one in verdicts for item in one["item"].split(", ")))
    if len(items) > 1 and all(item.startswith(f"{first['case']}::") for item in items):
        items = [first["case"]]
    for item in items:
        terminal.line(f"  rerun:  {rerun_command(session, item)}")


def _show_episode(
    session: DuraSession,
    terminal: Any,
    verdict: Data,
    episodes: Mapping[tuple[str, str], Data],
) -> None:
    """The worst episode, or one that spoilt the campaign, and how to see it again."""
    shown = _name(verdict)
    if shown is None:
        return
    episode = episodes.get((shown, verdict["component"]), {"faults": [], "events": []})
    if verdict["counterexamples"]:
        from pytest_dura.campaign.reasons import describe_counterexample

        terminal.line(f"  worst:  {describe_counterexample(verdict['counterexamples'][0])}")
        if not verdict["counterexamples"][0]["valid"]:
            terminal.line(f"  invalid: {episode.get('invalid_reason')}")
        # What ended the episode before its time, if anything did.
        for event in episode["events"]:
            if event["kind"] == "critical":
                terminal.line(f"  event:  {event_line(event)}")
    else:
        told = str(verdict["spoilt"]["detail"])
        word = verdict["spoilt"]["verdict"]
        if word != "missing" and not told.startswith(f"{word}: "):
            told = f"{word}: {told}"
        terminal.line(f"  {told}")
    for fault in episode["faults"]:
        chain = one_line(chain_line(fault), LONGEST)
        first, *rest = textwrap.wrap(chain, WIDTH - 12, break_on_hyphens=False)
        terminal.line(f"  fault:  {first}")
        for line in rest:
            terminal.line(f"            {line}")
    terminal.line(f"  replay: {replay_command(session, shown)}")


def _name(verdict: Data) -> str | None:
    """The id of the episode that stands for a verdict which is not "supported"."""
    if verdict["counterexamples"]:
        return str(verdict["counterexamples"][0]["episode"])
    return None if verdict["spoilt"] is None else str(verdict["spoilt"]["episode"])


def _named(record: SessionRecord, verdicts: Iterable[Data]) -> dict[tuple[str, str], Data]:
    """The episodes that stand for verdicts: of their components, and run by hand only if no other.

    They are found in one go, since a record may have a great many.
    """
    named = [(_name(one), one["component"]) for one in verdicts]
    wanted = {(shown, component) for shown, component in named if shown is not None}
    found: dict[tuple[str, str], Data] = {}
    for episode in record.episodes() if wanted else ():
        key = episode["id"], episode["component"]
        if key in wanted and (key not in found or episode["planned"] > found[key]["planned"]):
            found[key] = episode
    return found
