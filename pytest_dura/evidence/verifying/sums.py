"""Whether a record agrees with itself: its sums, its references, its bounds and its gate."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from hashlib import sha256
from math import isclose
from typing import Any

from pytest_dura.core.episode import canonical
from pytest_dura.evidence.bundle.directory import RECORD
from pytest_dura.evidence.record.counts import Counts
from pytest_dura.evidence.record.repeats import repeat_objections, repeat_problems
from pytest_dura.evidence.record.searches import NOTHING, standing
from pytest_dura.evidence.record.searches import against as sentence
from pytest_dura.evidence.record.session_record import SessionRecord
from pytest_dura.evidence.redaction.redactor import holds_redaction
from pytest_dura.evidence.verifying.episodes import episode_problems
from pytest_dura.evidence.verifying.searches import search_problems
from pytest_dura.evidence.verifying.shards import shard_problems
from pytest_dura.provenance.sources import digest_of
from pytest_dura.requirements.statistics import METHOD
from pytest_dura.requirements.statistics.exact import upper_bound

Data = Mapping[str, Any]
Key = tuple[str, str]
_COUNTED = ("flagged", "collided", "gridlock")


def record_problems(record: SessionRecord, counts: Counts) -> Iterator[str]:
    """Everything in which a record contradicts itself."""
    for problem in _problems(record, counts):
        yield f"{RECORD}: {problem}"


def _problems(record: SessionRecord, counts: Counts) -> Iterator[str]:
    yield from _session(record, counts)
    cases = {(one["id"], one["component"]): one for one in record["cases"]}
    requirements = {one["id"] for one in record["requirements"]}
    ids: set[Key] = set()
    sums: dict[Key, Counter[str]] = defaultdict(Counter)
    known: set[bytes] = set()
    digests: dict[Key, set[str]] = {
        (one["repeat"]["episode"], one["component"]): set()
        for one in record["cases"]
        if one["repeat"] is not None
    }
    described = {one["name"] for one in _components(record)} | {"none"}
    for episode in record.episodes():
        ids.add((episode["id"], episode["component"]))
        if (episode["id"], episode["component"]) in digests:
            digests[episode["id"], episode["component"]].add(episode["digest"])
        if episode["component"] not in described:
            yield f"component_under_test: {episode['component']} is not described"
        if (episode["case"], episode["component"]) not in cases:
            yield f"episode {episode['id']}: its case is not listed"
        else:
            case = cases[episode["case"], episode["component"]]
            yield from episode_problems(episode, case, record["base_seed"])
        inputs = canonical([episode["component"], {**episode["spec"], "timeouts": None}])
        if (digest := sha256(inputs).digest()) in known:
            yield f"episode {episode['id']}: it is listed twice"
        known.add(digest)
        if episode["planned"]:
            _add(sums[episode["case"], episode["component"]], episode)
    for key, case in cases.items():
        yield from _case(case, sums[key])
        repeated = case["repeat"] and (case["repeat"]["episode"], case["component"])
        for problem in repeat_problems(case, digests.get(repeated, ())):
            yield f"case {case['id']}: {problem}"
    for one in record["verdicts"]:
        yield from _verdict(one, cases, requirements, ids)
    yield from _questions(record)
    yield from _coverage(record)
    yield from _gate(record)
    yield from search_problems(record)
    yield from shard_problems(record)


def _session(record: SessionRecord, counts: Counts) -> Iterator[str]:
    if record["status"] != "complete":
        yield f"the session is {record['status']}: its evidence is incomplete"
    if record["totals"] != counts.to_json():
        yield f"totals: {record['totals']}, and it holds {counts.to_json()}"
    cases = {(one["id"], one["component"]): one for one in record["cases"]}
    requirements = {one["id"] for one in record["requirements"]}
    if len(cases) < len(record["cases"]):
        yield "cases: one of them is listed twice"
    if len(requirements) < len(record["requirements"]):
        yield "requirements: one of them is listed twice"
    hashed = {(one["path"], one["sha256"]) for one in record["inputs"]}
    for file in (file for one in _components(record) for file in one.get("files") or ()):
        if (file["path"], file["sha256"]) not in hashed:
            yield f"inputs: {file['path']} of the component is not among them"
    yield from _sources(record)
    for tape in (one["cassette"] for one in record["models"] if one["cassette"]):
        if (tape["file"], tape["sha256"]) not in hashed:
            yield f"inputs: the cassette {tape['file']} is not among them as it was replayed"
    if record["timings"]["evidence_seconds"] > record["timings"]["wall_seconds"]:
        yield "timings: the evidence took longer than the session"


def _sources(record: SessionRecord) -> Iterator[str]:
    """Whether the digests of components come out of those of their files."""
    sources = record["component_under_test"].get("sources", {})
    used = set()
    for one in _components(record):
        name, digest = f"component {one['name']}", one.get("digest")
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
        if one["file_count"] != len(named):
            yield f"{name}: {one['file_count']} files, and {len(named)} are listed"
        for file in one["files"]:
            if file["sha256"] not in named.values():
                yield f"{name}: {file['path']} is none of the files that its digest is made of"
    for digest in sorted(set(sources) - used):
        yield f"component_under_test: files of the digest {digest}, which no component has"


def _questions(record: SessionRecord) -> Iterator[str]:
    """Whether each question is answered once, and is the one that its requirement asks."""
    asked: Counter[str] = Counter()
    listed = {one["id"]: one for one in record["requirements"]}
    for one in record["verdicts"]:
        yield from _question(one, listed.get(one["requirement"]))
        parts = [one[name] for name in ("requirement", "case", "component", "item", "check")]
        asked[canonical([*parts, one["paired"], one["method"], _limits(one)]).decode()] += 1
    for question, count in asked.items():
        if count > 1:
            yield f"verdicts: {question} is answered twice"


def _question(one: Data, requirement: Data | None) -> Iterator[str]:
    """Whether what was asked is what the requirement says, as far as it says it."""
    if requirement is None:
        return
    name = f"verdict {one['requirement']} on {one['case']}"
    if requirement["check"] and one["check"] not in ("", requirement["check"]):
        yield f"{name}: judged by {one['check']!r}, and its check is {requirement['check']!r}"
    if requirement["at_most"] is not None and _limits(one) != [
        requirement["at_most"], requirement["confidence"],
    ]:  # fmt: skip
        yield f"{name}: judged by {_limits(one)}, and its rate and confidence are others"


def _limits(verdict: Data) -> list[Any]:
    return [verdict["bound"]["at_most"], verdict["bound"]["confidence"]]


def _components(record: SessionRecord) -> list[Data]:
    first = record["component_under_test"]
    return [first, *first.get("others", ())]


def _add(sums: Counter[str], episode: Data) -> None:
    sums["run"] += 1
    sums[episode["validity"]] += 1
    sums["ended_early"] += episode["termination"] == "decided"
    for key in _COUNTED:
        if episode["outcome"][key]:
            sums[f"{key}.run"] += 1
            sums[f"{key}.valid"] += episode["validity"] == "valid"


def _case(case: Data, sums: Mapping[str, int]) -> Iterator[str]:
    metrics = case["metrics"]
    told = {word: metrics[word] for word in ("run", "valid", "invalid", "missing", "ended_early")}
    for key in _COUNTED:
        for over in ("valid", "run"):
            if metrics[key] is not None:
                told[f"{key}.{over}"] = metrics[key][over]
    for name, count in told.items():
        if count != sums[name]:
            yield f"case {case['id']}: {name} is {count}, and its episodes say {sums[name]}"


def _verdict(
    one: Data, cases: Mapping[Key, Data], requirements: set[str], episodes: set[Key]
) -> Iterator[str]:
    name = f"verdict {one['requirement']} on {one['case']}"
    if one["requirement"] not in requirements:
        yield f"{name}: the requirement is not listed"
    if (one["case"], one["component"]) not in cases:
        yield f"{name}: the case is not listed"
    named = [counterexample["episode"] for counterexample in one["counterexamples"]]
    for episode in (*named, *one["open"], *one["unseen_crashes"]):
        if (episode, one["component"]) not in episodes:
            yield f"{name}: its episode {episode} is not listed"
    yield from _counts(name, one)
    yield from _word(name, one)


def _counts(name: str, one: Data) -> Iterator[str]:
    """Whether the counts of a verdict go together."""
    if one["episodes"] + one["invalid"] + one["missing"] != one["run"]:
        yield f"{name}: valid, invalid and missing episodes do not add up to {one['run']}"
    valid = sum(counterexample["valid"] for counterexample in one["counterexamples"])
    listed = valid, len(one["counterexamples"]) - valid
    if (one["violations"], one["without_effect"]) != listed:
        counts = f"{one['violations']} violations, {one['without_effect']} without effect"
        yield f"{name}: {counts}, and {listed[0]} and {listed[1]} counterexamples"
    if one["violations"] + len(one["open"]) > one["episodes"]:
        yield f"{name}: more violations and open episodes than the {one['episodes']} valid ones"
    if one["without_effect"] > one["invalid"]:
        yield f"{name}: more violations without effect than the {one['invalid']} invalid episodes"


def _upper(name: str, one: Data) -> Iterator[str]:
    """Whether the bound is that of the counts, and there is none of runs that are all equal."""
    bound = one["bound"]
    if one["situation"] is not None:
        if bound["upper"] is not None:
            yield f"{name}: its runs are equal, and a rate is bound"
    elif bound["method"] == METHOD and one["episodes"]:
        worst = one["violations"] + len(one["open"])
        upper = upper_bound(min(worst, one["episodes"]), one["episodes"], bound["confidence"])
        if bound["upper"] is None or not isclose(bound["upper"], upper, rel_tol=1e-9):
            yield f"{name}: the bound is {bound['upper']}, and its counts give {upper}"


def _word(name: str, one: Data) -> Iterator[str]:
    """Whether the counts allow the word; the statistics are computed again where n is fixed."""
    bound, word = one["bound"], one["verdict"]
    exact = bound["method"] == METHOD
    yield from _upper(name, one)
    broken = one["violations"] or one["without_effect"]
    if word == "violated" and not broken and one["pairs"] is None:
        yield f"{name}: violated without a violation"
    if word != "supported":
        return
    if one["missing"] or not one["episodes"]:
        yield f"{name}: supported, {one['episodes']} episodes valid and {one['missing']} missing"
    if one["run"] + one["saved"] < one["planned"]:
        yield f"{name}: supported with {one['run']} of {one['planned']} planned runs"
    if bound["at_most"] is None and (one["violations"] or one["open"]):
        counts = f"{one['violations']} violations and {len(one['open'])} open episodes"
        yield f"{name}: supported with {counts}"
    if one["without_effect"] or one["unseen_crashes"]:
        yield f"{name}: supported, although an invalid run violates it or a crash violates nothing"
    too_high = exact and bound["at_most"] is not None
    if too_high and (bound["upper"] is None or bound["upper"] > bound["at_most"]):
        yield f"{name}: supported with a bound of {bound['upper']} above {bound['at_most']}"


def _coverage(record: SessionRecord) -> Iterator[str]:
    """Whether each verdict has its cell, and each tested cell its verdict."""
    decided: dict[tuple[str, str], set[str]] = defaultdict(set)
    for one in record["verdicts"]:
        decided[one["requirement"], one["case"]].add(one["verdict"])
    cells = defaultdict(set)
    for cell in record["coverage"]["cells"]:
        if cell["verdict"] is not None:
            cells[cell["requirement"], cell["case"]].add(cell["verdict"])
    for requirement, case in sorted(set(cells) - set(decided)):
        yield f"coverage: {requirement} on {case} counts as tested, and has no verdict"
    for key, words in sorted(cells.items()):
        if key in decided and not words <= decided[key]:
            yield f"coverage: {key[0]} on {key[1]} is not {', '.join(sorted(words))}"


def _gate(record: SessionRecord) -> Iterator[str]:
    gate = record["gate"]
    accepted = {"supported"} | ({"undecided"} if gate["warn_undecided"] else set())
    against = [
        f"{one['requirement']} on {one['case']} is {one['verdict']}"
        for one in record["verdicts"]
        if one["verdict"] not in accepted and one["waiver"] is None
    ]
    against += [
        sentence(outcome["requirement"], one["case"], word)
        for one in record["searches"]
        for outcome in one["outcomes"]
        if one["waiver"] is None and (word := standing(one, outcome)) != NOTHING
        if word != "undecided" or not gate["warn_undecided"]
    ]
    if gate["result"] == "passed":
        if against or record["status"] != "complete" or gate["exit_code"] != 0:
            why = against[0] if against else f"status {record['status']}"
            yield f"gate: passed, although {why} (exit code {gate['exit_code']})"
    elif not gate["reasons"]:
        yield f"gate: {gate['result']}, and no reason is given"
    if gate["result"] != "passed" and gate["exit_code"] == 0:
        yield f"gate: {gate['result']}, and the exit code is 0"
    unrepeated = repeat_objections(record["cases"]) if record["require_repeatable"] else iter(())
    if gate["result"] == "passed" and (objection := next(unrepeated, None)) is not None:
        yield f"gate: passed, although it requires cases to be repeatable: {objection}"
    if gate["result"] == "passed" and gate["failed"]:
        yield f"gate: passed, although {gate['failed']} test items failed"
    if gate["result"] == "passed" and gate["reasons"]:
        yield f"gate: passed, although {gate['reasons'][0]}"
    if (gate["result"] == "incomplete") != (record["status"] != "complete"):
        yield f"gate: {gate['result']}, and the session is {record['status']}"
    if gate["result"] != "passed" and (untold := sorted({*against} - {*gate["reasons"]})):
        yield f"gate: {untold[0]}, which is no reason of it"
