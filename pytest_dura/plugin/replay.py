"""``--dura-replay``: an episode of the evidence again, and where it differs if it does."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.messages import say
from pytest_dura.plugin.places import beside
from pytest_dura.plugin.recorded import Recorded, damage_told, recorded_episodes

if TYPE_CHECKING:
    from pytest_dura.core.episode import Episode
    from pytest_dura.evidence.traces.trace import Trace
    from pytest_dura.plugin.session import DuraSession

OPTION = "--dura-replay"


def replay(session: DuraSession) -> int:
    """Run the episode again and return the exit code: 0 if the digests are equal, else 1.

    A page that plays the replayed episode goes beside the evidence, which stays as it is.

    Raises:
        ConfigurationError: For an unknown episode, one that cannot be built again, and a page that
            cannot be written.
    """
    from pytest_dura.evidence.traces.trace import Trace

    config, options = session.config, session.options
    name = str(options.replay)
    _, found = recorded_episodes(config, options, name, OPTION)
    equal = True
    for one in found:
        session.models.prepare(one.spec)
        with damage_told(options, name, OPTION):
            episode = one.run(recorded=True)
        # As a session would have kept it.
        trace = Trace.of(episode).without_secrets(session.redact)
        same, lines = _compared(one, episode, trace, options.evidence)
        equal &= same
        lines += [] if same else session.models.asked_anew()
        say([*lines, f"  player: {_page(one, episode, trace, options.evidence)}"])
    return 0 if equal else 1


def _compared(
    one: Recorded, episode: Episode, replayed: Trace, evidence: Path
) -> tuple[bool, list[str]]:
    """Whether the episode is the recorded one, and what there is to say of it."""
    same = one.digest == episode.digest
    end = f"{episode.time[-1]:.1f} s" if episode.ticks else "no tick"
    outcome = f"{episode.termination} after {end}"
    lines = [f"{episode.id} ({episode.spec.component}, seed {episode.spec.seed}): {outcome}"]
    if episode.failure is not None:
        lines.append(f"  {episode.failure}")
    lines += [f"  recorded digest {one.digest}", f"  replayed digest {episode.digest}"]
    lines.append(
        "  the same"
        if same
        else "  DIFFERENT: the code, a package or the platform has changed, "
        "or something is not deterministic"
    )
    if one.trace is None:
        return same, lines if same else [*lines, *_without_trace(one, episode)]
    try:
        recorded = _read_trace(one.trace, evidence)
    except FileNotFoundError:
        lines.append(f"  its trace {one.trace['file']} is not there any more")
        return same, lines if same else [*lines, *_by_faults(one, episode)]
    except ConfigurationError as error:
        told = [f"    {line}" for line in str(error).splitlines()]
        return False, [*lines, "  its trace cannot be compared:", *told]
    return _by_trace(recorded, replayed, one, episode, lines)


def _by_trace(
    recorded: Trace, replayed: Trace, one: Recorded, episode: Episode, lines: list[str]
) -> tuple[bool, list[str]]:
    """Whether the episode is the recorded one, and where it differs from its trace."""
    from pytest_dura.evidence.text import one_line
    from pytest_dura.evidence.traces.difference import first_difference

    first = first_difference(recorded, replayed)
    place = one_line(str(first), 1000)
    if one.digest != episode.digest:
        told = _by_faults(one, episode) if first is None else [f"  first difference: {place}"]
        return False, [*lines, *told]
    covered = first_difference(recorded, replayed, covered=True)
    if covered is not None:
        place = one_line(str(covered), 1000)
        return False, [*lines, f"  yet the trace that was kept is of another episode: {place}"]
    if first is not None:
        lines = [*lines, f"  what the digest leaves out is not the same: {place}"]
    return True, lines


def _without_trace(one: Recorded, episode: Episode) -> list[str]:
    kept = "no trace of it was kept (--dura-evidence-level=all keeps each)"
    return [f"  {kept}", *_by_faults(one, episode)]


def _by_faults(one: Recorded, episode: Episode) -> list[str]:
    """What the record itself tells of the episode, apart from its trace."""
    from pytest_dura.evidence.plain import plain

    for before, fault in zip(one.faults, episode.faults, strict=False):
        for key, value in plain(asdict(fault)).items():
            if key in before and before[key] != value:
                return [f"  fault {fault.id}: {key}: recorded {before[key]}, replayed {value}"]
    return ["  it is not known where they differ"]


def _read_trace(told: Any, evidence: Path) -> Trace:
    """The trace that was kept.

    Raises:
        FileNotFoundError: If it is gone.
        ConfigurationError: If it is another one than the record says, or damaged.
    """
    from pytest_dura.evidence.bundle.manifest import file_entry
    from pytest_dura.evidence.traces.mcap_file import read_trace
    from pytest_dura.evidence.traces.names import is_trace_path

    path = told.get("file")
    if not is_trace_path(path):
        raise ConfigurationError(
            "the record names a trace that is none of the bundle's",
            file=str(evidence / "evidence.json"),
            key="trace.file",
            found=path,
            expected="episodes/<name>.mcap",
        )
    file = evidence / path
    if not file.exists():
        raise FileNotFoundError(file)
    trace = read_trace(file)
    digest = file_entry(file)["sha256"]
    if digest != told.get("sha256"):
        raise ConfigurationError(
            "the trace is not the one that was recorded: its SHA-256 is another",
            file=str(file),
            found=digest,
            expected=told.get("sha256"),
            remedy="restore the file",
        )
    return trace


def _page(one: Recorded, episode: Episode, trace: Trace, evidence: Path) -> str:
    """Write the page that plays the episode; its URL.

    Raises:
        ConfigurationError: If it cannot be written.
    """
    from pytest_dura.evidence.bundle.files import write_file
    from pytest_dura.evidence.player.page import player_page
    from pytest_dura.evidence.traces.names import episode_name

    file = beside(evidence, "replay") / f"{episode_name(trace.about)}.html"
    write_file(file, [player_page(trace, _verdicts(one, episode))])
    return file.as_uri()


def _verdicts(one: Recorded, episode: Episode) -> list[dict[str, Any]]:
    """What the requirements of the episode's case say of it now."""
    from pytest_dura.requirements.verdicts.episodes import judge_episode

    found: list[dict[str, Any]] = []
    for requirement in one.requirements:
        if not requirement.check or requirement.paired is not None:
            continue
        try:
            verdict = judge_episode(requirement, episode)
        except ConfigurationError as error:  # such as a signal that a failed episode lacks
            told = {"requirement": requirement.id, "verdict": "missing", "detail": error.problem}
            found.append({**told, "check": requirement.check})
        else:
            found.append({**verdict.to_json(), "check": requirement.check})
    return found
