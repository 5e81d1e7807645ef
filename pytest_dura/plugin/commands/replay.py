"""``--dura-replay``: an episode of the evidence again, compared with its record, and its page.

Replaying and reducing begin alike: the record names an episode, which is built again from its spec,
with classes of conftest files where pytest has loaded them.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.messages import print_lines, sibling_directory
from pytest_dura.plugin.session.roles import defined_in_conftest

if TYPE_CHECKING:
    import pytest

    from pytest_dura.core.episode import Episode, EpisodeSpec
    from pytest_dura.core.metrics import TracedFault
    from pytest_dura.core.role_spec import RoleSpec
    from pytest_dura.evidence.episode_model import EpisodeEntry, TraceEntry
    from pytest_dura.evidence.model import SessionRecord
    from pytest_dura.evidence.traces import Trace
    from pytest_dura.plugin.options import Options
    from pytest_dura.plugin.session.session import DuraSession
    from pytest_dura.reports.html.twins import Twin
    from pytest_dura.requirements.model import Requirement


@dataclass(frozen=True)
class RecordedEpisode:
    """Episode of a record, ready to be run again.

    Args:
        spec: What it was run from, with classes of conftest files where pytest has loaded them.
        digest: As it was recorded.
        requirements: Those of its case.
        violated: Ids of those whose verdict names it as a counterexample.
        planned: Whether it is one of its case's runs; another one of that id has a seed by hand.
        trace: Where its trace is, as the record says; if one was kept.
        faults: What became of each of its faults.
    """

    spec: EpisodeSpec
    digest: str
    requirements: tuple[Requirement, ...]
    violated: tuple[str, ...]
    planned: bool
    trace: TraceEntry | None
    faults: Sequence[TracedFault]

    def run(self, spec: EpisodeSpec | None = None, *, recorded: bool = False) -> Episode:
        """Run the episode again, or another spec that ends as this one would.

        Args:
            spec: The other spec.
            recorded: Whether to keep what a viewer shows of it.
        """
        from pytest_dura.execution.task import run_episode
        from pytest_dura.requirements.checks import RequirementJudge

        end = self.spec.termination
        judge = RequirementJudge(self.requirements) if end.violation or end.decided else None
        return run_episode(spec or self.spec, judge, recorded=recorded)


def recorded_episodes(
    config: pytest.Config, options: Options, name: str, option: str
) -> tuple[SessionRecord, list[RecordedEpisode]]:
    """Read the record and its episodes of this id; seeds and components make several.

    Args:
        config: Of the session, for what conftest files define.
        options: Where the evidence is.
        name: ``case#run``.
        option: That named the episode, for messages.

    Raises:
        ConfigurationError: For an unknown episode, a damaged record, and an episode that cannot be
            built again.
    """
    from pytest_dura.evidence.bundle import RECORD_FILE, open_record

    record = open_record(options.evidence / RECORD_FILE)
    _check_whole(options.evidence, option)
    with damage_as_error(options, name, option):
        return record, [
            _recorded_episode(config, record, entry, option)
            for entry in _entries_named(record, name, option)
        ]


def recorded_failures(
    config: pytest.Config, options: Options, option: str
) -> Iterator[tuple[RecordedEpisode, list[Requirement]]]:
    """Yield the episodes of the record that violate requirements, each with these.

    Args:
        config: Of the session, for what conftest files define.
        options: Where the evidence is.
        option: That asks for them, for messages.

    Raises:
        ConfigurationError: For a damaged record, and an episode that cannot be built again.
    """
    from pytest_dura.evidence.bundle import RECORD_FILE, open_record

    record = open_record(options.evidence / RECORD_FILE)
    _check_whole(options.evidence, option)
    known = {requirement.id: requirement for requirement in record.head.requirements}
    for entry in record.episodes():
        violated = [
            known[name]
            for name, verdict in entry.verdicts.items()
            if verdict.status == "violated" and not known[name].paired
        ]
        if violated:
            yield _recorded_episode(config, record, entry, option), violated


def _check_whole(evidence: Path, option: str) -> None:
    """Refuse a bundle that differs from its manifest: it names what is imported and run.

    Raises:
        ConfigurationError: With the first difference.
    """
    from pytest_dura.evidence.files import manifest_problems

    problems = list(manifest_problems(evidence))
    if problems:
        rest = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise ConfigurationError(
            f"this bundle is not as it was written: {problems[0]}{rest}",
            file=str(evidence / "evidence.json"),
            key=option,
            found=len(problems),
            expected="a bundle that agrees with its manifest.json",
            remedy="run `python -m pytest_dura verify` on it, restore its files, or run the "
            "session again",
        )


@contextmanager
def damage_as_error(options: Options, name: str, option: str) -> Iterator[None]:
    """Context in which errors of a damaged record become one error.

    Raises:
        ConfigurationError: In place of whatever reading the record, or running what it says, met.
    """
    try:
        yield
    except (AttributeError, LookupError, TypeError, ValueError, ArithmeticError) as error:
        raise ConfigurationError(
            f"the record is damaged ({type(error).__name__}: {error})",
            file=str(options.evidence / "evidence.json"),
            key=option,
            found=name,
            expected="a record as pytest-dura wrote it",
            remedy="run the session again, or restore the file",
        ) from None


def _entries_named(record: SessionRecord, name: str, option: str) -> list[EpisodeEntry]:
    episodes = [episode for episode in record.episodes() if episode.id == name]
    if episodes:
        return episodes
    known = sorted({episode.id for episode in record.episodes()})
    near = difflib.get_close_matches(name, known, n=3, cutoff=0.4)
    expected = ", ".join(near or known[:3]) or "an episode; this evidence has none"
    raise ConfigurationError(
        f"the evidence has no episode {name!r}",
        key=option,
        found=name,
        expected=f"case#run, such as {expected}" if known else expected,
        remedy="name an episode of this session, or another evidence with --dura-evidence",
    )


def _recorded_episode(
    config: pytest.Config, record: SessionRecord, episode: EpisodeEntry, option: str
) -> RecordedEpisode:
    from pytest_dura.core.trust import check_registered
    from pytest_dura.evidence.redaction import holds_redaction

    spec = episode.spec
    if holds_redaction(spec.to_json()):
        raise ConfigurationError(
            f"the episode {episode.id!r} cannot be run again: what it was run from held a "
            "secret, which is not in the evidence",
            key=option,
            found=episode.id,
            expected="an episode whose spec is recorded whole",
            remedy="let the component read the secret from the environment, not from a parameter",
        )
    spec.check_rebuildable()
    paths = [spec.simulator.path, *(role.path for role in spec.roles.values())]
    for path in [*paths, *(fault.type for fault in spec.faults)]:
        if ":" in path:
            check_registered(path)
    roles = {name: _local_role(config, role, option) for name, role in spec.roles.items()}
    spec = replace(spec, roles=roles, simulator=_local_role(config, spec.simulator, option))
    head = record.head
    cases = {(case.id, case.component): case for case in head.cases}
    known = {requirement.id: requirement for requirement in head.requirements}
    violated = [
        verdict.requirement
        for verdict in head.verdicts
        for counterexample in verdict.counterexamples
        if counterexample.episode == episode.id and verdict.component == episode.component
    ]
    return RecordedEpisode(
        spec,
        episode.digest,
        tuple(known[name] for name in cases[episode.case, episode.component].requirements),
        tuple(dict.fromkeys(violated)),
        episode.planned,
        episode.trace,
        episode.faults,
    )


def _local_role(config: pytest.Config, role: RoleSpec, option: str) -> RoleSpec:
    from pytest_dura.library.roles import LocalRole

    file, _, name = role.path.rpartition(":")
    if not file.endswith("conftest.py"):
        return role
    factory = defined_in_conftest(config, file, name)
    if callable(factory):
        return LocalRole(role.path, factory, role.params)
    raise ConfigurationError(
        f"{name} is defined in {file}, which is not loaded here",
        key=option,
        found=role.path,
        expected="the arguments of the session, which load the same conftest files",
        remedy=f"add the folder of {file} to the command",
    )


_REPLAY_OPTION = "--dura-replay"


def replay(session: DuraSession) -> int:
    """Run the episode again and return the exit code: 0 if the digests are equal, else 1.

    A page that plays the replayed episode goes beside the evidence, which stays as it is.

    Raises:
        ConfigurationError: For an unknown episode, one that cannot be built again, and a page that
            cannot be written.
    """
    from pytest_dura.evidence.traces import Trace

    config, options = session.config, session.options
    name = str(options.replay)
    record, episodes = recorded_episodes(config, options, name, _REPLAY_OPTION)
    equal = True
    for recorded in episodes:
        session.guests.prepare(recorded.spec)
        with damage_as_error(options, name, _REPLAY_OPTION):
            episode = recorded.run(recorded=True)
        # As a session would have kept it.
        trace = Trace.of(episode).without_secrets(session.redact)
        is_same, lines = _compared(recorded, episode, trace, options.evidence)
        equal &= is_same
        lines += [] if is_same else session.guests.replay_warning()
        twins = _kept_twins(record, episode)
        lines += [_twin_line(twin) for twin in twins] or [
            "  no trace of the same seed without its faults or recovery is in the evidence"
        ]
        url = _write_player(recorded, episode, trace, twins, options.evidence)
        print_lines([*lines, f"  player: {url}"], session.redact)
    return 0 if equal else 1


def _compared(
    recorded: RecordedEpisode, episode: Episode, replayed: Trace, evidence: Path
) -> tuple[bool, list[str]]:
    """Return whether the episode is the recorded one, and lines that show it."""
    from pytest_dura.library.scenario import tolerances_of

    is_same = recorded.digest == episode.digest
    end = f"{episode.time[-1]:.1f} s" if episode.ticks else "no tick"
    outcome = f"{episode.termination} after {end}"
    lines = [f"{episode.id} ({episode.spec.component}, seed {episode.spec.seed}): {outcome}"]
    if episode.failure is not None:
        lines.append(f"  {episode.failure}")
    lines += [f"  recorded digest {recorded.digest}", f"  replayed digest {episode.digest}"]
    readers = list(_other_readers(recorded, episode))
    if is_same and readers:
        return False, [*lines, "  DIFFERENT: other roles read what a fault changed", *readers]
    lines.append(
        "  the same"
        if is_same
        else f"  DIFFERENT, as it may be: {recorded.spec.clock.not_repeatable}"
        if recorded.spec.clock.not_repeatable
        else "  DIFFERENT: the code, a package or the platform has changed, "
        "or something is not deterministic"
    )
    if recorded.trace is None and not is_same and tolerances_of(recorded.spec):
        why = "its simulator is not deterministic, and there are no signals to compare"
        lines[-1] = f"  DIFFERENT, as it may be: {why}"
    if recorded.trace is None:
        note = "  no trace of it was kept (--dura-evidence-level=all keeps each)"
        return is_same, lines if is_same else [*lines, note, *_by_faults(recorded, episode)]
    try:
        kept_trace = _read_trace(recorded.trace, evidence)
    except FileNotFoundError:
        lines.append(f"  its trace {recorded.trace.file} is not there any more")
        return is_same, lines if is_same else [*lines, *_by_faults(recorded, episode)]
    except ConfigurationError as error:
        reasons = [f"    {line}" for line in str(error).splitlines()]
        return False, [*lines, "  its trace cannot be compared:", *reasons]
    return _by_trace(kept_trace, replayed, recorded, episode, lines)


def _other_readers(recorded: RecordedEpisode, episode: Episode) -> Iterator[str]:
    """Describe the faults that other roles read than recorded; the digest leaves that out."""
    for fault in recorded.faults:
        now = list(episode.read_by.get(fault.id, ()))
        if now != list(fault.read_by):
            then = ", ".join(fault.read_by) or "none"
            yield f"    {fault.id}: recorded {then}, now {', '.join(now) or 'none'}"


def _by_trace(
    recorded: Trace,
    replayed: Trace,
    recorded_episode: RecordedEpisode,
    episode: Episode,
    lines: list[str],
) -> tuple[bool, list[str]]:
    """Return whether the episode is the recorded one, and lines that name the difference."""
    from pytest_dura.core.simulator import beyond_tolerance
    from pytest_dura.evidence.text import one_line
    from pytest_dura.evidence.traces import first_difference
    from pytest_dura.library.scenario import tolerances_of

    tolerances = tolerances_of(recorded_episode.spec)
    if tolerances is not None and recorded_episode.digest != episode.digest:
        beyond = beyond_tolerance(tolerances, recorded.signals, replayed.signals)
        return beyond is None, [*lines[:-1], _within(tolerances, beyond)]
    difference = first_difference(recorded, replayed)
    place = one_line(str(difference), 1000)
    if recorded_episode.digest != episode.digest:
        by_faults = (
            _by_faults(recorded_episode, episode)
            if difference is None
            else [f"  first difference: {place}"]
        )
        return False, [*lines, *by_faults]
    covered = first_difference(recorded, replayed, covered=True)
    if covered is not None:
        place = one_line(str(covered), 1000)
        return False, [*lines, f"  yet the trace that was kept is of another episode: {place}"]
    if difference is not None:
        lines = [*lines, f"  what the digest leaves out is not the same: {place}"]
    return True, lines


def _within(tolerances: Mapping[str, float], beyond: str | None) -> str:
    from pytest_dura.core.simulator import describe_tolerances

    if beyond is None:
        declared = describe_tolerances(tolerances)
        return f"  the same within the tolerances of its simulator, no further: {declared}"
    return f"  DIFFERENT beyond the tolerances of its simulator: {beyond}"


def _by_faults(recorded: RecordedEpisode, episode: Episode) -> list[str]:
    """Compare what became of the faults, which the record holds without a trace."""
    from pytest_dura.core.codec import encode

    for entry, fault in zip(recorded.faults, episode.faults, strict=False):
        known = encode(entry)
        for key, replayed in encode(fault).items():
            if known[key] != replayed:
                values = f"recorded {known[key]}, replayed {replayed}"
                return [f"  fault {fault.id}: {key}: {values}"]
    return ["  it is not known where they differ"]


def _read_trace(entry: TraceEntry, evidence: Path) -> Trace:
    """Read the trace that was kept.

    Raises:
        FileNotFoundError: If it is gone.
        ConfigurationError: If it is another one than the record says, or damaged.
    """
    from pytest_dura.evidence.files import file_entry
    from pytest_dura.evidence.mcap import read_trace

    file = evidence / entry.file
    if not file.exists():
        raise FileNotFoundError(file)
    trace = read_trace(file)
    digest = file_entry(file)["sha256"]
    if digest != entry.sha256:
        raise ConfigurationError(
            "the trace is not the one that was recorded: its SHA-256 is another",
            file=str(file),
            found=digest,
            expected=entry.sha256,
            remedy="restore the file",
        )
    return trace


def _kept_twins(record: SessionRecord, episode: Episode) -> list[Twin]:
    """Read the traces of the same seed without faults or without recovery that were kept."""
    from pytest_dura.reports.html.players import Traces
    from pytest_dura.reports.html.twins import TwinTraces

    spec, read = episode.spec, Traces(record).read
    return TwinTraces.of(record).of_seed(spec.case, spec.component, spec.seed, read)


def _twin_line(twin: Twin) -> str:
    shown = "it is shown beside this one" if twin.trace else f"it is not shown: {twin.problem}"
    return f"  the same seed {twin.label}: {shown}"


def _write_player(
    recorded: RecordedEpisode,
    episode: Episode,
    trace: Trace,
    twins: Sequence[Twin],
    evidence: Path,
) -> str:
    """Write the page that plays the episode, and return its URL.

    Raises:
        ConfigurationError: If it cannot be written.
    """
    from pytest_dura.evidence.files import write_file
    from pytest_dura.evidence.traces import episode_name
    from pytest_dura.reports.html.player import player_page

    file = sibling_directory(evidence, "replay") / f"{episode_name(trace.about)}.html"
    page = player_page(trace, _verdicts(recorded, episode), episode.described_measures, twins)
    write_file(file, [page])
    return file.as_uri()


def _verdicts(recorded: RecordedEpisode, episode: Episode) -> list[dict[str, Any]]:
    """Judge the replayed episode by the requirements of its case."""
    from pytest_dura.core.codec import fields_as_data
    from pytest_dura.requirements.episode_verdicts import judge_episode

    verdicts: list[dict[str, Any]] = []
    for requirement in recorded.requirements:
        if not requirement.check or requirement.paired is not None:
            continue
        about = {"check": requirement.check, "kind": requirement.kind}
        try:
            verdict = judge_episode(requirement, episode)
        except ConfigurationError as error:  # such as a signal that a failed episode lacks
            missing = {"requirement": requirement.id, "verdict": "missing", "detail": error.problem}
            verdicts.append({**missing, **about})
        else:
            verdicts.append({**fields_as_data(verdict), **about})
    return verdicts
