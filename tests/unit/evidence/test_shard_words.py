"""What formats say of a shard and of merged shards, and what verify says against them."""

from __future__ import annotations

import pytest
from session_records import session_record
from stated_counts import stated_counts

from pytest_dura.evidence import (
    ShardUnit,
    all_formats,
    plan_digest,
    write_record,
)
from pytest_dura.evidence.merge import merged_command
from pytest_dura.evidence.sessions import shard_problems
from pytest_dura.reports import shard_text
from pytest_dura.reports.wording import merge_text

HOSTILE = "<script>alert(1)</script>\n\n# Gate passed\n|x|"
HELD = [
    ShardUnit.of("case", "a/clear", ["a/clear::SAF-1"], 2),
    ShardUnit.of("test", "t.py::x", ["t"], 0),
]
PASSED = {"result": "passed", "exit_code": 0, "warn_undecided": False, "failed": 0, "reasons": []}


def shard(**changes):
    told = {
        "index": 2, "count": 5, "plan": "a" * 64, "units": 9,
        "holds": [vars(one) for one in HELD],
    }  # fmt: skip
    return {"shard": told | changes}


def parts(number=2, **changes):
    known = session_record()
    shards = [
        {
            "index": index, "count": number, "plan": "a" * 64, "units": 3,
            "created": known.head.created, "finished": known.head.finished, "command": HOSTILE,
            "environment": known.head.environment.replace(platform=HOSTILE), "gate": "failed",
            "exit_code": 1, "wall_seconds": 1.0, "evidence_seconds": 0.1,
            "record": f"{index}" * 64,
        }
        for index in range(1, min(number, 9) + 1)
    ]  # fmt: skip
    return {"merged_from": [{**one, **changes} for one in shards]}


@pytest.mark.parametrize("changes", [shard(), parts()], ids=["shard", "merged"])
def test_the_record_is_valid_and_every_format_states_its_counts(tmp_path, changes):
    record = session_record(tmp_path, **changes)
    write_record(tmp_path, record)
    for one in all_formats():
        text = one.render(record)
        assert stated_counts(one, text) == record.head.totals.to_json()
        assert "<script>alert" not in text
        if one.FILE.endswith(".md"):
            assert "\n# Gate passed" not in text


def test_a_whole_one_is_no_part():
    assert shard_text(session_record()) == merge_text(session_record()) == ""
    assert shard_text(session_record(**shard())) == "shard 2 of 5"
    assert merge_text(session_record(**parts())) == "2 shards, in one environment"
    sessions = parts(index=None, count=None, plan=None, units=None)
    assert merge_text(session_record(**sessions)) == "2 sessions, in one environment"
    first, second = parts()["merged_from"]
    profile = {"profile": "dura", "max_examples": 9, "derandomize": True, "database": False}
    for changes, where in (
        ({"hypothesis": profile}, "one environment"),
        ({"hypothesis": profile, "machine": "arm64"}, "environments that differ"),
    ):
        other = {**second, "environment": second["environment"].replace(**changes)}
        record = session_record(merged_from=[first, other])
        assert merge_text(record) == f"2 shards, in {where}"


@pytest.mark.parametrize(
    "changes, told",
    [
        (shard(), []),
        (shard(plan=plan_digest(HELD), units=2), []),
        (shard(plan=None, units=None, holds=[]), []),
        (shard(index=6), ["shard: 6 of 5"]),
        (shard(units=1), ["holds 2 units, and the whole session 1"]),
        (shard(units=2), ["they are not its plan"]),
        (shard(plan=None), ["units of no plan"]),
        (shard(holds=[vars(HELD[1]), vars(HELD[0])]), ["not sorted"]),
        (shard(holds=[vars(HELD[0])] * 2), ["listed twice"]),
        (shard(index=1, count=1), ["the only one holds 2 of 9"]),
        (shard() | parts(), ["it is a shard, and merged from shards"]),
        (parts(), []),
        (parts(1), []),
        ({"merged_from": parts()["merged_from"][1:]}, ["not every shard of a session"]),
        ({"merged_from": parts()["merged_from"][::-1]}, ["not in their order"]),
        ({"merged_from": []}, ["not in their order"]),
        (parts(record="b" * 64), ["one is there twice"]),
        (parts(10**15), ["not every shard of a session"]),
        (parts(index=None, count=None, plan=None, units=None), []),
        (parts(1, plan=None), ["a shard without a plan"]),
        (parts(created="2030-01-01T00:00:00+00:00"), ["when the first of its sessions began"]),
        (parts(finished="2030-01-01T00:00:00+00:00"), ["when the last of its sessions ended"]),
        (parts() | {"gate": PASSED}, ["gate: passed, although one of its sessions did not pass"]),
        (parts(gate="passed", exit_code=0) | {"gate": PASSED}, []),
    ],
)  # fmt: skip
def test_verify_finds_what_contradicts_itself(changes, told):
    found = list(shard_problems(session_record(**changes).head))
    assert len(found) == len(told), found
    assert all(what in one for what, one in zip(told, found, strict=True))


@pytest.mark.parametrize(
    "command, whole",
    [
        ("pytest --dura-shard=2/5 -n 2", "pytest -n 2 --dura-evidence=out"),
        ("pytest --dura-shard 2/5 tests", "pytest tests --dura-evidence=out"),
        ("pytest --dura-evidence a --dura-shard 2/5", "pytest --dura-evidence=out"),
        ("pytest 'a b' --dura-evidence=x", "pytest 'a b' --dura-evidence=out"),
        ("pytest --dura-shard", "pytest --dura-evidence=out"),
        ("pytest 'unbalanced", "pytest --dura-evidence=out"),
    ],
)
def test_the_command_of_the_whole_is_that_of_a_shard_without_it(tmp_path, command, whole):
    assert merged_command(command, tmp_path / "out") == whole.replace("=out", f"={tmp_path}/out")
