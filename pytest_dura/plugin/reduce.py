"""``--dura-reduce``: the smallest set of an episode's faults that still violates a requirement."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.commands import replay_command
from pytest_dura.plugin.messages import say
from pytest_dura.plugin.places import beside
from pytest_dura.plugin.recorded import Data, Recorded, damage_told, recorded_episodes
from pytest_dura.plugin.tables import counted

if TYPE_CHECKING:
    from pytest_dura.campaign.reduction import Reduction
    from pytest_dura.plugin.session import DuraSession

OPTION = "--dura-reduce"
PLACE = "reduced"
"""Behind the name of the evidence: where the reduced episode is recorded, to be replayed from."""


def reduce(session: DuraSession) -> int:
    """Reduce the faults of an episode; the exit code is 0 if its violation came up again, else 1.

    Raises:
        ConfigurationError: For an unknown episode, and one that violated nothing or has no faults.
    """
    from pytest_dura.campaign.reduction import BUDGET, reduce_faults

    options = session.options
    name = str(options.reduce)
    record, found = recorded_episodes(session.config, options, name, OPTION)
    # Verdicts name episodes without their seeds, and rest on planned runs.
    found.sort(key=lambda one: not one.planned)
    recorded = next((one for one in found if one.violated), found[0])
    _check(recorded, name)
    session.models.prepare(recorded.spec)
    judged = [one for one in recorded.requirements if one.id in recorded.violated]
    budget = BUDGET if options.runs is None else options.runs
    spec = recorded.spec
    violates = f"violates {', '.join(recorded.violated)}; at most {budget} runs"
    say([f"{name} ({spec.component}): {counted(len(spec.faults), 'fault')}, {violates}"])
    with damage_told(options, name, OPTION):
        reduction = reduce_faults(spec, judged, recorded.run, budget=budget, on_run=_show_run)
    lines = _told(reduction, budget)
    if reduction.episode is not None:
        folder = beside(options.evidence, PLACE)
        with damage_told(options, name, OPTION):
            _record(record, recorded, reduction, folder)
        lines.append(f"  replay: {replay_command(session, reduction.episode.id, folder)}")
    say(lines)
    return 0 if reduction.reproduced else 1


def _check(recorded: Recorded, name: str) -> None:
    if not recorded.spec.faults:
        raise ConfigurationError(
            f"the episode {name!r} has no faults to leave out",
            key=OPTION,
            found=name,
            expected="an episode with at least one fault",
        )
    checked = {one.id for one in recorded.requirements if one.check and not one.paired}
    if not set(recorded.violated) & checked:
        raise ConfigurationError(
            f"the episode {name!r} is no counterexample to a requirement that could be asked again",
            key=OPTION,
            found=", ".join(recorded.violated) or "no violation",
            expected="an episode that a verdict names as a counterexample, by a check in a file",
            remedy="choose an episode that the terminal shows as `worst` or `also in`",
        )


def _show_run(faults: Sequence[str], violated: Sequence[str]) -> None:
    told = f"violates {', '.join(violated)}" if violated else "violates nothing"
    say([f"  {' + '.join(faults) or 'none'}: {told}"])


def _told(reduction: Reduction, budget: int) -> list[str]:
    runs = f"{reduction.runs} of {budget} runs"
    if reduction.missing:
        runs += f", of which {reduction.missing} failed and say nothing"
    if reduction.reproduced is None:
        return [f"the budget ended before it was known whether it comes up again ({runs})"]
    if not reduction.reproduced:
        return [f"not reproduced: the same faults do not violate it again ({runs})"]
    faults = " + ".join(reduction.faults)
    violated = ", ".join(reduction.violated)
    if not reduction.faults:
        return [f"no fault is needed: it violates {violated} without any ({runs})"]
    if reduction.smallest:
        sure = "every smaller set was tried"
    elif reduction.one_minimal:
        sure = "none of them can be left out; smaller sets of others were not all tried"
    elif reduction.missing:
        sure = "it is not known whether one can be left out"
    else:
        sure = "the budget ended before it was known whether one can be left out"
    return [f"smallest set that violates {violated}: {faults} ({sure}; {runs})"]


def _record(record: Data, recorded: Recorded, reduction: Reduction, folder: Path) -> None:
    """A record with the reduced episode alone, in the form of the one that it came from."""
    from pytest_dura.evidence.bundle.directory import write_record
    from pytest_dura.evidence.bundle.files import write_file
    from pytest_dura.evidence.bundle.manifest import MANIFEST, file_entry, manifest_text
    from pytest_dura.evidence.record.episodes import episode_record
    from pytest_dura.evidence.record.session_record import SessionRecord

    episode = reduction.episode
    assert episode is not None
    own = recorded.spec.case, recorded.spec.component
    (before,) = [one for one in record["cases"] if (one["id"], one["component"]) == own]
    case: dict[str, Any] = {**before, "id": episode.spec.case, "planned": 1}
    case["faults"] = [dict(fault) for fault in episode.spec.faults]
    case.pop("metrics", None)
    told = {
        "cases": [case],
        "episodes": [episode_record(episode, planned=True)],
        "verdicts": [],
        "monitors": [],
        "baseline": None,
        "reduced_from": recorded.spec.id,
    }
    file = write_record(folder, SessionRecord.of({**record, **told}, folder))
    write_file(folder / MANIFEST, [manifest_text({file.name: file_entry(file)})])
