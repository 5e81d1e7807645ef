"""Episodes on disk: told apart by their inputs, given back in order, bounded in memory."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from entries import make

from pytest_dura import ConfigurationError
from pytest_dura.core.metrics import FaultRecord
from pytest_dura.evidence.episode_model import EpisodeEntry, TraceEntry
from pytest_dura.evidence.episodes import EpisodeSpool
from pytest_dura.evidence.lines import FaultTrace, KeptTrace

DIGEST = "d" * 64
TRACE = make(TraceEntry, file="episodes/x.mcap").to_json()


TOLERATED = FaultRecord("f", "lidar").traced(outcome="tolerated")


def episode(run=0, case="a/b", component="C", seed=None, faults=(), **changes):
    told = {
        "id": f"{case}#{run}", "case": case, "component": component, "planned": True,
        "seed": run if seed is None else seed, "digest": DIGEST,
        "faults": [{"id": name} for name in faults], "spec": {"run": run, "seed": seed or 0},
    }  # fmt: skip
    return make(EpisodeEntry, **told | changes).to_json()


def test_episodes_come_back_by_case_component_run_and_seed():
    places = [
        ("a/b", "C", 2, 5), ("a/b", "C", 10, 0), ("a/b", "C", 10, 2**70), ("a/b", "D", 0, 0),
        ("a/\udcff", "C", 0, 0), ("a/\U0001f600", "C", 0, 0),
    ]  # fmt: skip
    spool = EpisodeSpool()
    for case, component, run, seed in [places[i] for i in (3, 1, 5, 0, 4, 2)]:
        spool.add(episode(run, case, component, seed))
    told = [(one.case, one.component, one.spec.run, one.seed) for one in spool]
    assert told == sorted(places) == places
    assert [one.id for one in spool] == [one.id for one in spool], "it can be read again"


def test_the_first_of_equal_inputs_stays_and_planned_holds_once_it_was_true():
    spool = EpisodeSpool()
    assert spool.add(episode(digest="d" * 64, planned=False)) == DIGEST
    assert spool.add(episode(digest="e" * 64, planned=True)) == DIGEST
    assert spool.add(episode(digest="f" * 64, planned=False)) == DIGEST
    late = episode(digest="f" * 64)
    late["spec"]["timeouts"] = [3]
    assert spool.add(late) == DIGEST, "recorded timeouts are no inputs of it"
    (found,) = spool
    assert (found.digest, found.planned) == (DIGEST, True)


def test_chains_are_told_of_planned_episodes_whichever_comes_first():
    spool = EpisodeSpool()
    spool.add_chain(FaultTrace("C", "a/b#0", TOLERATED))
    spool.add_chain(FaultTrace("C", "a/b#0", replace(TOLERATED, outcome="violated")))
    spool.add_chain(FaultTrace("D", "a/b#0", TOLERATED))
    spool.add(episode(faults=("f", "g"), digest="d" * 64))
    spool.add(episode(faults=("f",), digest="e" * 64, seed=7, planned=False))
    planned, by_hand = spool
    assert [fault.outcome for fault in planned.faults] == ["violated", None]
    assert [fault.outcome for fault in by_hand.faults] == [None]


def test_a_trace_belongs_to_one_digest_and_may_be_told_before_the_episode():
    spool = EpisodeSpool()
    spool.add_trace(KeptTrace("a/b#0", "C", DIGEST, TRACE))
    spool.add(episode(digest="d" * 64))
    spool.add(episode(digest="e" * 64, seed=7))
    assert [one.trace for one in spool] == [TraceEntry(**TRACE), None]


def test_of_what_workers_tell_of_a_trace_the_violation_stays_whoever_tells_it_first():
    reasons = "all", "violation", "sample", "missing"
    for order in (reasons, reasons[::-1]):
        spool = EpisodeSpool()
        spool.add(episode(digest="d" * 64))
        for reason in order:
            trace = TRACE | {"kept_for": reason}
            spool.add_trace(KeptTrace("a/b#0", "C", DIGEST, trace))
        assert [one.trace.kept_for for one in spool] == ["violation"]


def test_it_leaves_no_file_even_if_it_is_never_closed(tmp_path):
    spool = EpisodeSpool(tmp_path / "new")
    spool.add(episode())
    assert list((tmp_path / "new").iterdir()) == []
    assert len(list(spool)) == 1


def test_where_nothing_can_be_written_it_says_so(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigurationError, match="the episodes of the session cannot be kept"):
        EpisodeSpool(tmp_path / "file" / "folder")


def test_what_is_added_after_a_reading_is_in_the_next():
    spool = EpisodeSpool()
    spool.add(episode(faults=("f",)))
    assert [(each.trace, each.faults[0].outcome) for each in spool] == [(None, None)]
    spool.add_trace(KeptTrace("a/b#0", "C", DIGEST, TRACE))
    assert [each.trace for each in spool] == [TraceEntry(**TRACE)]
    reading = iter(spool)
    spool.add_chain(FaultTrace("C", "a/b#0", TOLERATED))
    list(reading)
    assert [each.faults[0].outcome for each in spool] == ["tolerated"]


@pytest.mark.parametrize("size, kept", [(1, True), (7_000_000, False)])
def test_only_a_session_of_some_size_is_kept_in_memory(size, kept):
    spool = EpisodeSpool()
    text = random.Random(0).randbytes(size).hex()  # which takes so many bytes in the file
    spool.add(episode(failure=text))
    (first,), (again,) = spool, spool
    assert first == again
    assert (first is again) == kept
