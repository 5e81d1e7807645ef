"""Check what a record has that cannot be computed again: it must not contradict itself.

These are episodes, searches, references and monitors. Each function yields a sentence for every
contradiction that it finds.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from itertools import pairwise
from pathlib import PurePosixPath, PureWindowsPath
from typing import Any, NamedTuple

from pytest_dura.core.codec import encode
from pytest_dura.core.episode import canonical, outcome_of
from pytest_dura.core.metrics import EpisodeMetrics, FaultCounts
from pytest_dura.core.seeding import derive_seed
from pytest_dura.evidence.bundle import RECORD_FILE
from pytest_dura.evidence.case_model import CaseEntry
from pytest_dura.evidence.conclusions.verdicts import question_key
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.episodes import episode_order
from pytest_dura.evidence.gate import NOTHING_FOUND, VIOLATED_OUTCOMES, repeat_problems
from pytest_dura.evidence.hazards import hazard_problems
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import SessionRecord, components_under_test
from pytest_dura.evidence.redaction import holds_redaction
from pytest_dura.evidence.searches import RecordedSearch
from pytest_dura.evidence.session_model import ComponentEntry, ComponentUnderTest
from pytest_dura.evidence.sessions import resume_problems, shard_problems
from pytest_dura.evidence.text import one_line
from pytest_dura.provenance import digest_of
from pytest_dura.requirements.campaign_verdicts import TEST_FAILED
from pytest_dura.requirements.episode_verdicts import EARLY_ENDS, CheckVerdict
from pytest_dura.requirements.judgements import Judgement
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.searches import FoundCounterexample, SearcherReport, SearchOutcome


def episode_problems(episode: EpisodeEntry, case: CaseEntry, base_seed: int) -> Iterator[str]:
    """Yield the contradictions within an episode.

    Args:
        episode: Of the record.
        case: Its case.
        base_seed: From which the seeds of planned runs follow.
    """
    problems = (
        *_input_problems(episode, case, base_seed),
        *_metric_problems(episode),
        *_chain_problems(episode),
        *_declared_verdict_problems(episode, case),
    )
    for problem in problems:
        yield f"episode {episode.id}: {problem}"


def _input_problems(episode: EpisodeEntry, case: CaseEntry, base_seed: int) -> Iterator[str]:
    name, spec = episode.id, episode.spec
    seed = derive_seed(base_seed if case.seed is None else case.seed, spec.scenario_name, spec.run)
    seed = seed if case.seed is None or spec.run else case.seed
    if episode.planned and episode.seed != seed:
        yield f"planned, and its seed is {episode.seed}, not {seed} as that of its run"
    if name != f"{spec.case}#{spec.run}" or episode.case != spec.case:
        yield f"its spec is that of {spec.case}#{spec.run}"
    faults = [[(fault.id, fault.type, fault.target) for fault in of.faults] for of in (case, spec)]
    if spec.scenario_name != case.scenario or faults[0] != faults[1]:
        yield f"its spec has {spec.scenario_name} with {faults[1]}, and its case {faults[0]}"
    if spec.timeouts is None:
        yield "its spec does not say which calls overran their budget"
    if episode.seed != spec.seed:
        yield f"seed {episode.seed}, and {spec.seed} in its spec"
    if (episode.validity == "missing") != (episode.failure is not None):
        yield f"{episode.validity}, and its failure is {episode.failure!r}"
    if (episode.validity == "invalid") != (
        episode.failure is None and episode.invalid_reason is not None
    ):
        yield f"{episode.validity}, because {episode.invalid_reason!r}"
    missing = {fault.id for fault in spec.faults}
    missing -= {fault.id for fault in episode.faults}
    if missing:
        yield f"there is no entry for its faults {', '.join(sorted(missing))}"


def _metric_problems(episode: EpisodeEntry) -> Iterator[str]:
    """Compare what an episode measures with its outcome, its faults and its events."""
    metrics, faults = episode.metrics, episode.faults
    counts = FaultCounts.summed_up(faults)
    if metrics.faults != counts:
        yield f"its faults are {encode(metrics.faults)}, and they come to {encode(counts)}"
    outcome = episode.outcome
    if metrics.recoveries != outcome.recoveries:
        yield f"{metrics.recoveries} recoveries, and {outcome.recoveries} in its outcome"
    if metrics.alerts != outcome.alerts:
        yield f"{metrics.alerts} alerts, and {outcome.alerts} in its outcome"
    if metrics.valid_proposals > metrics.proposals:
        yield "more valid proposals than there were"
    yield from _tally_problems(metrics, outcome.switching.decisions)
    oldest = max(metrics.answer_ages, default=0.0)
    lasted = episode.timings.simulated_seconds
    if oldest > round(lasted, 9):  # as ages are
        yield f"a decision came into force {oldest} s after its percept, within {lasted} s"
    first: dict[str, float] = {}
    for event in episode.events:
        if event.kind == "fault_manifested":
            first.setdefault(event.subject, event.time)
    for fault in faults:
        if fault.manifested_at != first.get(fault.id):
            manifested = f"{fault.id} manifested at {fault.manifested_at} s"
            yield f"{manifested}, and its events say {first.get(fault.id)}"


def _chain_problems(episode: EpisodeEntry) -> Iterator[str]:
    """Derive latencies and outcome of each fault from the rest of its chain again."""
    alerts = {event.time for event in episode.events if event.kind == "alert"}
    for fault in episode.faults:
        name = fault.id
        for latency, seconds in fault.latencies().items():
            if (recorded := getattr(fault, latency)) != seconds:
                yield f"{name}: {latency} is {recorded} s, and its times give {seconds}"
        if fault.read_by and not fault.success:
            yield f"{name}: read by {', '.join(fault.read_by)}, and it never manifested"
        detected, began = fault.detected_at, fault.began_at
        if detected is not None and (not fault.success or began is None or detected < began):
            yield f"{name}: detected at {detected} s, and no alert of then can answer it"
        elif detected is not None and detected not in alerts:
            yield f"{name}: detected at {detected} s, and its events say of no alert then"
        without = fault.violated_without
        if extra := sorted({*(without or ())} - {*fault.violated}):
            yield f"{name}: {extra[0]} is violated without it, and not with it"
        outcome = fault.outcome
        missing = episode.failure is not None
        expected = outcome_of(fault, fault.propagation, fault.violated, without, missing=missing)
        if outcome is None and fault.violated:
            yield f"{name}: violated, and it has no outcome"
        if outcome not in (None, expected):
            yield f"{name}: its outcome is {outcome!r}, and its chain gives {expected!r}"


def _declared_verdict_problems(episode: EpisodeEntry, case: CaseEntry) -> Iterator[str]:
    """Hold an episode's verdicts on the requirements of its case against the episode."""
    for name, verdict in episode.verdicts.items():
        if name not in case.requirements:
            yield f"a verdict on {name}, which its case does not declare"
        for problem in _check_verdict_problems(verdict, episode):
            yield f"{name} is {problem}"


def _check_verdict_problems(verdict: CheckVerdict, episode: EpisodeEntry) -> Iterator[str]:
    """Yield what a check cannot say of an episode that came to this."""
    status, margin, time = verdict.status, verdict.margin, verdict.time
    if status in ("satisfied", "open") and episode.validity != "valid":
        yield f"{status}, and the run is {episode.validity}"
    if status == "invalid" and episode.validity == "missing":
        yield f"{status}, and the run is {episode.validity}"
    if status == "open" and episode.termination not in EARLY_ENDS:
        yield f"{status}, and the run ended by {episode.termination}"
    unexplained = not verdict.detail.startswith((INFRASTRUCTURE, TEST_FAILED))
    if status == "missing" and episode.validity != "missing" and unexplained:
        yield f"{status}, and no error says why"
    if time is not None and (status != "violated" or time > episode.timings.simulated_seconds):
        yield f"{status} at {time} s of {episode.timings.simulated_seconds} s"
    if status == "satisfied" and margin is not None and margin < 0:
        yield f"{status} by {margin}"
    if verdict.vacuous and status != "satisfied":
        yield f"{status}, and vacuous"


INFRASTRUCTURE = "infrastructure: "


def judgement_problems(record: SessionRecord) -> Iterator[str]:
    """Yield the contradictions between judgements and the runs that they name."""
    cases = {(case.id, case.component): case for case in record.head.cases}
    doubtful = {(doubt.case, doubt.component) for doubt in record.head.doubts}
    references: dict[str, set[str]] = {}
    for listed in record.head.cases:
        references.setdefault(listed.reference or "", set()).add(listed.id)
    named: dict[str, list[_NamedRun]] = {}
    for judgement in record.head.judgements:
        place = f"judgement {judgement.requirement} on {judgement.case} by {judgement.item}"
        case = cases.get((judgement.case, judgement.component))
        if case is not None and judgement.planned > case.planned:
            yield f"{place}: {judgement.planned} runs planned, and {case.planned} of its case"
        for problem in _unlisted_arms(judgement, cases, references):
            yield f"{place}: {problem}"
        yield from (f"{place}: {problem}" for problem in _form_problems(judgement))
        for run in judgement.runs:
            named.setdefault(run.digest, []).append(
                _NamedRun(place, judgement, run.run, run.verdict)
            )
            if run.twin:
                twin = _NamedRun(place, judgement, run.run, run.twin_verdict)
                named.setdefault(run.twin, []).append(twin)
            if run.reference:
                third = _NamedRun(place, judgement, run.run, run.reference_verdict)
                named.setdefault(run.reference, []).append(third)
    for episode in record.episodes():
        for each in named.pop(episode.digest, ()):
            for problem in each.problems(episode):
                yield f"{each.place}: {episode.id} is {problem}"
    for each in (each for entries in named.values() for each in entries):
        if (each.judgement.case, each.judgement.component) not in doubtful:
            yield f"{each.place}: one of its runs is not recorded"


def _unlisted_arms(
    judgement: Judgement,
    cases: Container[tuple[str, str]],
    references: Mapping[str, Container[str]],
) -> Iterator[str]:
    """Yield which cases of second and third runs are not listed."""
    paired, of_component = judgement.paired, (judgement.twins, judgement.component)
    listed: Container[str] = references.get(paired.reference, ()) if paired is not None else ()
    is_reference = paired is not None and bool(paired.reference) and not paired.without
    known = of_component in cases or not judgement.twins
    if not (judgement.twins in listed if is_reference else known):
        yield "the case of its second runs is not listed"
    if paired is not None and paired.prevents:
        if judgement.references not in listed:
            yield "the case of its third runs is not listed"
    elif judgement.references:
        yield "third runs, and no reference"


def _form_problems(judgement: Judgement) -> Iterator[str]:
    """Yield what a judgement of its kind does not have."""
    kind = judgement.kind
    by_test, is_claim = kind == "test", kind == "claim"
    asked = judgement.until_decided or judgement.twins or judgement.paired or judgement.check
    if is_claim and (judgement.runs or asked):
        yield "a claim, and it asks something of runs"
    if not by_test and judgement.decides != (judgement.recorded_as or judgement.item):
        yield f"a {kind} of {judgement.item}, recorded as {judgement.decides}"
    if is_claim != (judgement.attempt == 0):
        yield f"a {kind} of attempt {judgement.attempt}"
    if by_test != (judgement.assertion is not None) or (by_test and len(judgement.runs) != 1):
        yield f"a {kind} on {len(judgement.runs)} runs, with the assertion {judgement.assertion}"
    if bool(judgement.twins) != (judgement.paired is not None):
        yield f"second runs of {judgement.twins!r}, and pairs as in {judgement.paired}"


class _NamedRun(NamedTuple):
    """A run that a judgement names, and what its own check says of it."""

    place: str
    judgement: Judgement
    number: int
    verdict: CheckVerdict | None

    def problems(self, episode: EpisodeEntry) -> Iterator[str]:
        """Yield the contradictions with the episode of the run."""
        if self.number != episode.spec.run:
            yield f"run {episode.spec.run}, and not {self.number}"
        if self.verdict is None:
            return
        yield from _check_verdict_problems(self.verdict, episode)
        own = episode.verdicts.get(self.judgement.requirement)
        by_test = self.judgement.kind == "test" and self.verdict.status == "satisfied"
        if by_test and own is not None and own.status != "satisfied":
            yield f"{self.verdict.status}, and {own.status} by the check of the requirement"


def _tally_problems(metrics: EpisodeMetrics, decisions: int) -> Iterator[str]:
    """Check that no tally counts more than there were decisions."""
    for name, tally in metrics.tallies.items():
        for part, hits, of in (
            ("hits", tally.hits, tally.of),
            ("null_hits", tally.null_hits, tally.null_of),
        ):
            if not hits <= of <= decisions:
                yield f"{hits} of {of} for {name} ({part}), in {decisions} decisions"
    for noun, answers in (("times", metrics.answer_seconds), ("ages", metrics.answer_ages)):
        if len(answers) > decisions:
            yield f"the {noun} of {len(answers)} answers, in {decisions} decisions"


_EPISODE_MARK = "@"
"""Part of the id of a case that a search chose, and of no scenario's name."""
_SILENT_SHARE = 0.2
"""Share of simulations without a result above which a search is undecided."""


def search_problems(record: SessionRecord) -> Iterator[str]:
    """Yield the contradictions within searches, and between them and the rest of the record."""
    yield from _search_in_rate_problems(record)
    listed = {requirement.id: requirement for requirement in record.head.requirements}
    described = {component.name for component in components_under_test(record)}
    counter: Counter[bytes] = Counter()
    for search in record.head.searches:
        place = f"search by {search.item} on {search.case}"
        counter[canonical(replace(search, waiver=None))] += 1
        if search.component not in described:
            yield f"{place}: {search.component} is not described"
        for problem in (*_search_count_problems(search), *_outcome_problems(search, listed)):
            yield f"{place}: {problem}"
    if any(count > 1 for count in counter.values()):
        yield "searches: one of them is listed twice"


def _search_in_rate_problems(record: SessionRecord) -> Iterator[str]:
    """Check that no rate is made of cases that a search chose.

    A planned episode is one of the runs of its case, and named after it.
    """
    for case in record.head.cases:
        if _EPISODE_MARK in case.id and (case.planned or case.metrics.run):
            yield f"case {case.id}: a search chose it, and there are metrics of it"
    for verdict in record.head.verdicts:
        name = f"verdict {verdict.requirement} on {verdict.case}"
        if _EPISODE_MARK in verdict.case:
            yield f"{name}: a search chose the case, and no rate can be made of it"
        for counterexample in verdict.counterexamples:
            if _EPISODE_MARK in counterexample.episode:
                yield f"{name}: a search chose its counterexample {counterexample.episode}"


def _search_count_problems(search: RecordedSearch) -> Iterator[str]:
    total = search.simulations
    if not 0 < total <= search.budget:
        yield f"{total} simulations, and its budget is {search.budget}"
    if search.unknown > total:
        yield f"{search.unknown} of {total} simulations decided nothing"
    if search.not_manifested > total:
        yield f"an added fault never came to act in {search.not_manifested} of {total} simulations"
    done = sum(searcher.simulations for searcher in search.searchers)
    if done != total:
        yield f"{total} simulations, and its searchers did {done}"
    names = [outcome.requirement for outcome in search.outcomes]
    if not names or len(set(names)) < len(names):
        yield f"it is for the requirements {', '.join(names) or 'of none'}"
    yield from _searcher_problems(search, names)


def _searcher_problems(search: RecordedSearch, names: Sequence[str]) -> Iterator[str]:
    for kind, searchers in (("searchers", search.searchers), ("baselines", search.baselines)):
        if len({searcher.name for searcher in searchers}) < len(searchers):
            yield f"one of its {kind} is listed twice"
        for searcher in searchers:
            yield from (
                f"{searcher.name}: {each}" for each in _problems_of_searcher(searcher, names)
            )
    for baseline in search.baselines:
        if not baseline.trivial:
            yield f"{baseline.name} learns, and is no baseline"
        if baseline.simulations > search.simulations:
            yield f"{baseline.name}: a baseline of {baseline.simulations} simulations"


def _problems_of_searcher(searcher: SearcherReport, names: Sequence[str]) -> Iterator[str]:
    if set(searcher.best) != set(names) or set(searcher.first) != set(names):
        yield "its figures are of other requirements"
    for name, first in searcher.first.items():
        if first is not None and first > searcher.simulations:
            yield f"violated {name} at {first} of its {searcher.simulations} simulations"


def _outcome_problems(search: RecordedSearch, listed: Mapping[str, Requirement]) -> Iterator[str]:
    for outcome in search.outcomes:
        name = outcome.requirement
        problems = [
            *_outcome_status_problems(search, outcome),
            *_first_violation_problems(search, outcome),
        ]
        if outcome.counterexample is not None:
            problems += _counterexample_problems(search, outcome.counterexample)
        if name not in listed:
            problems.append("the requirement is not listed")
        elif listed[name].check not in ("", outcome.check):
            problems.append(f"searched {outcome.check!r}, which is not its check")
        yield from (f"{name}: {problem}" for problem in problems)


def _outcome_status_problems(search: RecordedSearch, outcome: SearchOutcome) -> Iterator[str]:
    """Check the status of an outcome against its counterexample and its silent simulations."""
    status, counterexample = outcome.status, outcome.counterexample
    if (counterexample is not None) != (status in VIOLATED_OUTCOMES):
        yield f"{status}, and {'a' if counterexample is not None else 'no'} counterexample"
    elif counterexample is not None:
        repeats = counterexample.repeats
        if not max(repeats.violated, repeats.equal) <= repeats.runs:
            yield f"more repeats than {repeats.runs}"
        if repeats.confirmed != (status == "falsified"):
            text = f"{repeats.violated} violated and {repeats.equal} equal"
            yield f"{status}, and of {repeats.runs} replays {text}"
        if not search.baselines:
            yield f"{status}, and no baseline stands beside it"
    else:
        silent = search.unknown > _SILENT_SHARE * search.simulations
        if silent and status == NOTHING_FOUND:
            text = f"{search.unknown} of {search.simulations}"
            yield f"{status}, though {text} simulations decided nothing of a requirement"
        if not silent and status == "undecided":
            text = f"only {search.unknown} simulations"
            yield f"{status}, and {text} decided nothing of a requirement"


def _first_violation_problems(search: RecordedSearch, outcome: SearchOutcome) -> Iterator[str]:
    """Compare first violation and least robustness with those of the searchers."""
    name, total = outcome.requirement, search.simulations
    hits, baseline_hits = (
        _first_violations(searchers, name) for searchers in (search.searchers, search.baselines)
    )
    if outcome.counterexample is None:
        if outcome.simulations != total or outcome.searcher is not None:
            yield f"nothing violated it, in {outcome.simulations} of {total} simulations"
        for who, first in hits.items():
            yield f"{who} violated it at its simulation {first}, and there is no counterexample"
    elif not hits and outcome.searcher in baseline_hits:
        if outcome.simulations != baseline_hits[outcome.searcher]:
            yield f"violated at simulation {outcome.simulations} of a baseline"
    elif outcome.searcher not in hits:
        yield f"{outcome.searcher} found it, and violated nothing"
    elif not hits[outcome.searcher] <= outcome.simulations <= total:
        yield f"violated at simulation {outcome.simulations} of {total}"
    known = [each.best.get(name) for each in search.searchers]
    least = min((best for best in known if best is not None), default=None)
    if outcome.best != least:
        yield f"its least robustness is {outcome.best}, and its searchers say {least}"


def _first_violations(searchers: Sequence[SearcherReport], requirement: str) -> dict[str, int]:
    """Number of the first violating simulation of each searcher that violated a requirement."""
    firsts = {each.name: each.first.get(requirement) for each in searchers}
    return {who: first for who, first in firsts.items() if first is not None}


def _counterexample_problems(
    search: RecordedSearch, counterexample: FoundCounterexample
) -> Iterator[str]:
    if not counterexample.case.startswith(f"{search.scenario}{_EPISODE_MARK}"):
        place = f"its counterexample {counterexample.case}"
        yield f"{place} is of another scenario than {search.scenario}"
    recorded = counterexample.scenario.get("name"), counterexample.scenario.get("seed")
    if recorded != (search.scenario, counterexample.seed):
        place = f"its counterexample is {search.scenario} with seed {counterexample.seed}"
        yield f"{place}, and says {recorded}"
    paths = [change.path for change in counterexample.changes]
    if len(set(paths)) < len(paths):
        yield "a parameter of its counterexample changed twice"
    shrinking = counterexample.shrinking
    if shrinking is not None:
        if shrinking.simulations > shrinking.budget:
            spent = shrinking.simulations
            yield f"{spent} simulations to make it simpler, and {shrinking.budget} were allowed"
        if shrinking.after > shrinking.before:
            yield f"made simpler from {shrinking.before} to {shrinking.after} parameters"
    file = counterexample.file
    if (file is None) != (counterexample.name is None):
        yield f"its counterexample is kept in {file} as {counterexample.name}"
    if file is not None and (
        PurePosixPath(file).is_absolute() or PureWindowsPath(file).is_absolute()
    ):
        yield f"it is kept in {file}, which is a path of one machine"
    if file is not None and counterexample.repeats.equal != counterexample.repeats.runs:
        yield f"it is kept in {file}, and was never confirmed"


EpisodeKey = tuple[str, str]


def record_problems(record: SessionRecord) -> Iterator[str]:
    """Yield the contradictions within a record, each with the name of its file."""
    for problem in _all_problems(record):
        yield f"{RECORD_FILE}: {problem}"


def _all_problems(record: SessionRecord) -> Iterator[str]:
    yield from _session_problems(record)
    cases = {(case.id, case.component): case for case in record.head.cases}
    requirements = {requirement.id for requirement in record.head.requirements}
    ids: set[EpisodeKey] = set()
    known: set[bytes] = set()
    digests: dict[EpisodeKey, set[str]] = {
        (case.repeat.episode, case.component): set()
        for case in record.head.cases
        if case.repeat is not None
    }
    described = {component.name for component in components_under_test(record)} | {"none"}
    if any(episode_order(one) > episode_order(two) for one, two in pairwise(record.episodes())):
        yield "episodes: not in the order of case, component, run and seed"
    for episode in record.episodes():
        key = episode.id, episode.component
        ids.add(key)
        if key in digests:
            digests[key].add(episode.digest)
        if episode.component not in described:
            yield f"component_under_test: {episode.component} is not described"
        if (episode.case, episode.component) not in cases:
            yield f"episode {episode.id}: its case is not listed"
        else:
            case = cases[episode.case, episode.component]
            yield from episode_problems(episode, case, record.head.base_seed)
        inputs = canonical([episode.component, replace(episode.spec, timeouts=None)])
        if (digest := sha256(inputs).digest()) in known:
            yield f"episode {episode.id}: it is listed twice"
        known.add(digest)
    for case in record.head.cases:
        override = case.runs_override
        if override is not None and case.planned not in (0, override):
            planned = f"{case.planned} runs planned"
            yield f"case {case.id}: {planned}, and --dura-runs={override} replaces them"
        repeated = case.repeat.episode if case.repeat else "", case.component
        asked = bool(record.head.models)
        for problem in repeat_problems(case, digests.get(repeated, ()), asked_models=asked):
            yield f"case {case.id}: {problem}"
    for verdict in record.head.verdicts:
        yield from _verdict_problems(verdict, cases, requirements, ids)
    yield from judgement_problems(record)
    yield from hazard_problems(record)
    yield from _question_problems(record)
    yield from _monitor_problems(record, cases)
    yield from search_problems(record)
    yield from resume_problems(record)
    yield from shard_problems(record)


def _session_problems(record: SessionRecord) -> Iterator[str]:
    failed = record.head.failed_items or []
    if failed != sorted(set(failed)) or len(failed) != record.head.gate.failed:
        yield f"failed_items: {len(failed)} items, and {record.head.gate.failed} at the gate"
    if record.head.status != "complete":
        yield f"the session is {record.head.status}: its evidence is incomplete"
    cases = {(case.id, case.component): case for case in record.head.cases}
    requirements = {requirement.id for requirement in record.head.requirements}
    if len(cases) < len(record.head.cases):
        yield "cases: one of them is listed twice"
    if len(requirements) < len(record.head.requirements):
        yield "requirements: one of them is listed twice"
    hashed = {(file.path, file.sha256) for file in record.head.inputs}
    for component in components_under_test(record):
        yield from _unhashed_problems(component, hashed)
    yield from _source_problems(record)
    for tape in (model.cassette for model in record.head.models if model.cassette):
        if (tape.file, tape.sha256) not in hashed:
            yield f"inputs: the cassette {tape.file} is not among them as it was replayed"
    if record.head.timings.evidence_seconds > record.head.timings.wall_seconds:
        yield "timings: the evidence took longer than the session"


def _unhashed_problems(
    component: ComponentUnderTest | ComponentEntry, hashed: set[tuple[str, str | None]]
) -> Iterator[str]:
    for file in component.files or ():
        if (file.path, file.sha256) not in hashed:
            yield f"inputs: {file.path} of the component is not among them"


def _source_problems(record: SessionRecord) -> Iterator[str]:
    """Compute the digests of components from those of their files again."""
    sources = record.head.component_under_test.sources or {}
    used = set()
    for component in components_under_test(record):
        name, digest = f"component {component.name}", component.digest
        if digest is None:
            continue
        used.add(digest)
        named = sources.get(digest)
        if named is None:
            yield f"{name}: no files are listed of which its digest could be made"
            continue
        # Without the name that was a secret it cannot be made again.
        if not holds_redaction(list(named)) and digest_of(named) != digest:
            yield f"{name}: its digest is not that of its files"
        if component.file_count != len(named):
            yield f"{name}: {component.file_count} files, and {len(named)} are listed"
        for file in component.files or ():
            if file.sha256 not in named.values():
                yield f"{name}: {file.path} is none of the files that its digest is made of"
    for digest in sorted(set(sources) - used):
        yield f"component_under_test: files of the digest {digest}, which no component has"


def _question_problems(record: SessionRecord) -> Iterator[str]:
    """Check that each question is answered once, and is the one that its requirement asks."""
    questions: Counter[tuple[str, ...]] = Counter()
    listed = {requirement.id: requirement for requirement in record.head.requirements}
    for verdict in record.head.verdicts:
        yield from _problems_of_question(verdict, listed.get(verdict.requirement))
        questions[question_key(verdict.item, verdict)] += 1
    for question, count in questions.items():
        if count > 1:
            yield f"verdicts: {' '.join(question[:4])} is answered twice"


def _problems_of_question(verdict: ItemVerdict, requirement: Requirement | None) -> Iterator[str]:
    """Compare check and limits of a verdict with those of its requirement, as far as it has any."""
    if requirement is None:
        return
    name = f"verdict {verdict.requirement} on {verdict.case}"
    if requirement.check and verdict.check not in ("", requirement.check):
        yield f"{name}: judged by {verdict.check!r}, and its check is {requirement.check!r}"
    if requirement.at_most is not None and _limits(verdict) != [
        requirement.at_most, requirement.confidence,
    ]:  # fmt: skip
        yield f"{name}: judged by {_limits(verdict)}, and its rate and confidence are others"


def _limits(verdict: ItemVerdict) -> list[Any]:
    """Greatest rate and confidence that a verdict was made with."""
    return [verdict.bound.at_most, verdict.bound.confidence]


def _verdict_problems(
    verdict: ItemVerdict,
    cases: Mapping[EpisodeKey, CaseEntry],
    requirements: set[str],
    episodes: set[EpisodeKey],
) -> Iterator[str]:
    name = f"verdict {verdict.requirement} on {verdict.case}"
    if verdict.requirement not in requirements:
        yield f"{name}: the requirement is not listed"
    if (verdict.case, verdict.component) not in cases:
        yield f"{name}: the case is not listed"
    named = [counterexample.episode for counterexample in verdict.counterexamples]
    for episode in (*named, *verdict.open, *verdict.unseen_crashes):
        if (episode, verdict.component) not in episodes:
            yield f"{name}: its episode {episode} is not listed"


def _monitor_problems(
    record: SessionRecord, cases: Mapping[EpisodeKey, CaseEntry]
) -> Iterator[str]:
    """Compute the rates of monitors from their counts again."""
    for number, monitor in enumerate(record.head.monitors):
        name = f"monitors/{number}"
        if (monitor.case, monitor.component) not in cases:
            yield f"{name}: its case is not listed"
        yield from differences(f"/{name}", encode(monitor), encode(monitor.with_rates()))
        times = monitor.delays if monitor.horizon is None else monitor.lead_times
        if len(times) != monitor.true_positives or (monitor.delays and monitor.lead_times):
            yield f"{name}: {monitor.true_positives} true positives, and {len(times)} times of them"
        if monitor.late + monitor.early > monitor.false_negatives:
            yield f"{name}: more late and early alarms than false negatives"
        if monitor.false_positives > monitor.false_alarms:
            yield f"{name}: fewer false alarms than episodes with one"


_ABSENT = "nothing"


def differences(pointer: str, recorded: Any, computed: Any) -> Iterator[str]:
    """Yield the places, as JSON pointers, at which plain data differs from computed data."""
    if isinstance(recorded, Mapping) and isinstance(computed, Mapping):
        for key in [*recorded, *(key for key in computed if key not in recorded)]:
            place = f"{pointer}/{str(key).replace('~', '~0').replace('/', '~1')}"
            if key in recorded and key in computed:
                yield from differences(place, recorded[key], computed[key])
            else:
                kinds = ("a value", _ABSENT) if key in recorded else (_ABSENT, "a value")
                yield f"{place}: found {kinds[0]}, expected {kinds[1]}"
    elif isinstance(recorded, list) and isinstance(computed, list):
        if len(recorded) != len(computed):
            yield f"{pointer}: found {len(recorded)} entries, expected {len(computed)}"
        for number, (found, expected) in enumerate(zip(recorded, computed, strict=False)):
            yield from differences(f"{pointer}/{number}", found, expected)
    elif recorded != computed or isinstance(recorded, bool) != isinstance(computed, bool):
        yield f"{pointer}: found {_short(recorded)}, expected {_short(computed)}"


def _short(value: Any) -> str:
    """JSON of a value, cut short."""
    return one_line(json.dumps(value, ensure_ascii=False), _MAX_SHOWN)


_MAX_SHOWN = 100
