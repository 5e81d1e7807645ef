"""One file for several processes, which is refused with one error where it cannot be used."""

from __future__ import annotations

import gc
import json
import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import replace

import pytest

from pytest_dura.__main__ import main
from pytest_dura.core import ConfigurationError, TimeBudgetExceeded, call_within, environment_errors
from pytest_dura.llm import Answer, Cassette, Message, Request
from pytest_dura.llm.cassette import Exchange, text_digest

HOSTILE = "\x1b]0;owned\x07\x7f\u202e\ud800\x00|`<b>\n\u2028"


def exchange(text="hello", answer="world", number=0):
    request = Request("m", (Message("system", "drive"), Message("user", text)), {"type": "object"})
    told = Answer(answer, usage={"total_tokens": number})
    return Exchange(request.key("f"), "f", request.to_json(), told, "2026-01-02T03:04:05+00:00")


@pytest.fixture
def tape(tmp_path):
    return tmp_path / "a folder" / "tape?mode=rw#1.sqlite"


@pytest.fixture
def recorded(tape):
    cassette = Cassette(tape, writable=True)
    cassette.add(exchange())
    description = {"model": "m", "base_url": "http://h/v1", "fingerprint": "f"}
    cassette.describe(description, "session")
    cassette.close()
    return tape


def refused(tape, words, *, writable=False):
    with pytest.raises(ConfigurationError) as caught:
        Cassette(tape, writable=writable)
    told = str(caught.value)
    assert words in told
    assert "--dura-cassette" in told
    assert caught.value.__cause__ is None
    return told


def test_what_is_stored_comes_back_and_the_first_stays(tape):
    cassette = Cassette(tape, writable=True)
    assert cassette.find(exchange().key) is None
    assert cassette.add(exchange()) == exchange().answer
    assert cassette.add(exchange(answer="another")) == exchange().answer
    assert list(cassette.exchanges()) == [exchange()]
    assert list(cassette.exchanges("n")) == []
    assert list(tape.parent.iterdir()) == [tape]


def test_hostile_texts_come_back_as_they_were(tape):
    cassette = Cassette(tape, writable=True)
    cassette.add(exchange(HOSTILE, HOSTILE))
    cassette.close()
    assert list(Cassette(tape, writable=False).exchanges()) == [exchange(HOSTILE, HOSTILE)]


def test_a_text_is_stored_once(tape):
    cassette = Cassette(tape, writable=True)
    for number in range(250):
        cassette.add(exchange(f"prompt {number}"))
    assert [one.request["messages"][1]["text"] for one in cassette.exchanges()] == [
        f"prompt {number}" for number in range(250)
    ]
    with closing(sqlite3.connect(tape)) as opened:
        assert opened.execute("SELECT COUNT(*) FROM texts").fetchone() == (252,)


WORK = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[3])
from test_cassette_file import exchange
from pytest_dura.llm.cassette import Cassette
cassette = Cassette(Path(sys.argv[1]), writable=True)
print(*[cassette.add(exchange(f"{i}", sys.argv[2])).text for i in range(60)])
"""


def test_processes_that_record_at_once_agree_on_every_answer(tape):
    here = str(__file__).rpartition("/")[0]
    workers = [
        subprocess.Popen(
            [sys.executable, "-c", WORK, tape, name, here], stdout=subprocess.PIPE, text=True
        )
        for name in ("a", "b", "c")
    ]
    told = [worker.communicate()[0].split() for worker in workers]
    assert [worker.returncode for worker in workers] == [0, 0, 0]
    assert told[0] == told[1] == told[2]
    assert set(told[0]) <= {"a", "b", "c"}
    assert len(told[0]) == len(Cassette(tape, writable=False)) == 60


def test_replay_leaves_the_file_as_it_is(recorded):
    before = recorded.read_bytes()
    recorded.chmod(0o400)
    cassette = Cassette(recorded, writable=False)
    assert cassette.find(exchange().key) == exchange().answer
    with pytest.raises(ConfigurationError, match="the cassette cannot be read"):
        cassette.add(exchange("more"))
    cassette.close()
    assert recorded.read_bytes() == before
    assert list(recorded.parent.iterdir()) == [recorded]


def test_a_file_that_is_missing_is_not_made_in_replay(tape):
    refused(tape, "there is no such cassette")
    assert not tape.exists()


@pytest.mark.parametrize("writable", [False, True])
@pytest.mark.parametrize(
    "content, words",
    [(b"{}" * 3000, "file is not a database"), (b"SQLite format 3\0" + b"x" * 4096, "cannot be")],
)
def test_a_file_that_is_no_database_stays_as_it_is(tmp_path, content, words, writable):
    file = tmp_path / "notes.json"
    file.write_bytes(content)
    refused(file, words, writable=writable)
    assert file.read_bytes() == content


@pytest.mark.parametrize("writable", [False, True])
def test_the_database_of_another_program_stays_as_it_is(tmp_path, writable):
    file = tmp_path / "other.sqlite"
    other = sqlite3.connect(file)
    other.execute("CREATE TABLE exchanges (key TEXT)")
    other.commit()
    other.close()
    before = file.read_bytes()
    refused(file, "this file is no cassette", writable=writable)
    assert file.read_bytes() == before


@pytest.mark.parametrize("writable", [False, True])
def test_a_newer_form_is_not_guessed_at(recorded, writable):
    newer = sqlite3.connect(recorded)
    newer.execute("PRAGMA user_version = 2")
    newer.close()
    refused(recorded, "found:    'version 2'", writable=writable)


def test_a_truncated_file_is_refused(recorded):
    data = recorded.read_bytes()
    recorded.write_bytes(data[: len(data) // 2 // 4096 * 4096])
    refused(recorded, "the cassette cannot be read")


def test_a_directory_is_refused(tmp_path):
    refused(tmp_path, "there is no such cassette")
    refused(tmp_path, "the cassette is a directory", writable=True)
    (tmp_path / "file").touch()
    refused(tmp_path / "file" / "tape", "the cassette cannot be written", writable=True)


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE exchanges SET answer = '{'",
        "UPDATE exchanges SET answer = '[]'",
        "UPDATE exchanges SET answer = '{\"words\": 1}'",
        "UPDATE exchanges SET answer = x'ff'",
        "UPDATE exchanges SET request = '{}'",
        "UPDATE exchanges SET request = '{\"messages\": 7}'",
        "UPDATE texts SET text = 'x'",
        "DELETE FROM texts",
        *(
            f"UPDATE exchanges SET answer = json_set(answer, '$.{change})"
            for change in (
                "text', 5", "detail', NULL", "failure', 'banana'", "seconds', 'x'",
                "seconds', -1.0", "seconds', 9e999", "usage', json('[1]')", "usage.a', 'x'",
            )
        ),
        f"UPDATE exchanges SET answer = '{'[' * 100_000}'",
        *(
            f"UPDATE exchanges SET request = json_{change})"
            for change in (
                "remove(request, '$.seed'", "set(request, '$.messages[0]', 1",
                "set(request, '$.messages[0].images', 5", "remove(request, '$.messages[0].role'",
            )
        ),
        "UPDATE texts SET text = '5'",
    ],
)  # fmt: skip
def test_what_somebody_changed_by_hand_is_one_error(recorded, statement):
    by_hand = sqlite3.connect(recorded)
    by_hand.execute(statement)
    by_hand.commit()
    by_hand.close()
    cassette = Cassette(recorded, writable=False)
    with pytest.raises(ConfigurationError, match="the cassette cannot be read"):
        list(cassette.exchanges())


@pytest.mark.parametrize(
    "change",
    ["'$.model', 5", "'$.capabilities', json('[]')", "'$.fingerprint', NULL"],
)
def test_a_description_that_somebody_changed_is_one_error(recorded, change):
    by_hand = sqlite3.connect(recorded)
    by_hand.execute(f"UPDATE models SET description = json_set(description, {change})")
    by_hand.commit()
    by_hand.close()
    with pytest.raises(ConfigurationError, match="of a model is no"):
        Cassette(recorded, writable=False).descriptions()


def test_a_cassette_that_is_dropped_lets_go_of_its_file(recorded):
    cassette = Cassette(recorded, writable=False)
    connection = cassette._open
    del cassette
    gc.collect()
    with pytest.raises(sqlite3.ProgrammingError, match="closed"):
        connection.execute("SELECT 1")


ENDLESS = (
    "WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r)"
    " SELECT 'a' AS sha256, COUNT(*) AS text FROM r"
)


@pytest.mark.parametrize("writable", [False, True])
@pytest.mark.parametrize(
    "statements",
    [
        "DROP TABLE texts",
        f"ALTER TABLE texts RENAME TO t; CREATE VIEW texts AS {ENDLESS}",
        "CREATE TRIGGER t AFTER INSERT ON exchanges BEGIN DELETE FROM texts; END",
    ],
)
def test_what_only_bears_the_names_of_a_cassettes_tables_is_refused(recorded, statements, writable):
    by_hand = sqlite3.connect(recorded)
    by_hand.executescript(statements)
    by_hand.close()
    refused(recorded, "it is made of other tables than a cassette", writable=writable)


HALF = """
import os, sqlite3, sys
by_hand = sqlite3.connect(sys.argv[1], isolation_level=None)
by_hand.execute("PRAGMA cache_size = 1")
by_hand.execute("BEGIN")
by_hand.execute("UPDATE exchanges SET answer = 'half'")
by_hand.executemany("INSERT INTO texts VALUES (?, ?)", [(str(i), "x" * 3000) for i in range(99)])
os.kill(os.getpid(), 9)
"""


def killed_in_the_middle_of_a_write(tape):
    subprocess.run([sys.executable, "-c", HALF, tape], check=False)
    journal = tape.with_name(tape.name + "-journal")
    assert journal.stat().st_size
    return journal


def test_a_write_in_whose_middle_a_process_was_killed_is_undone(recorded, tmp_path):
    journal = killed_in_the_middle_of_a_write(recorded)
    link = tmp_path / "link"
    link.symlink_to(recorded)
    assert Cassette(link, writable=False).find(exchange().key) == exchange().answer
    assert not journal.exists()


def test_where_such_a_write_cannot_be_undone_the_error_says_how(recorded, monkeypatch):
    killed_in_the_middle_of_a_write(recorded)
    connect = sqlite3.connect
    monkeypatch.setattr(
        "sqlite3.connect", lambda name, **more: connect(name.replace("=rw", "=ro"), **more)
    )
    told = refused(recorded, "was ended while it wrote, which cannot be undone here")
    assert "tape?mode=rw#1.sqlite-journal to where they can be written" in told


def test_what_ends_a_process_as_a_transaction_begins_leaves_none_open(tape):
    cassette = Cassette(tape, writable=True)
    real = cassette._open

    class Ended(BaseException):
        pass

    class Interrupted:
        in_transaction = property(lambda _: real.in_transaction)

        def execute(self, statement, *values):
            found = real.execute(statement, *values)
            if statement == "BEGIN IMMEDIATE":
                raise Ended  # as a time limit does between two lines
            return found

    cassette._open = Interrupted()
    with pytest.raises(Ended):
        cassette.add(exchange())
    cassette._open = real
    assert cassette.add(exchange()) == exchange().answer


def test_a_component_is_not_slow_whose_time_ends_while_the_cassette_is_locked(tape, monkeypatch):
    monkeypatch.setattr("pytest_dura.llm.cassette.PATIENCE", 0.3)
    monkeypatch.setattr("pytest_dura.llm.cassette.LONG", 0.1)
    cassette = Cassette(tape, writable=True)
    other = sqlite3.connect(tape, isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    with environment_errors() as heard, pytest.raises(TimeBudgetExceeded):
        call_within(0.15, cassette.find, exchange().key)
    assert [one.source for one in heard] == ["cassette"]
    assert "kept the cassette locked for too long" in str(heard[0])
    other.execute("ROLLBACK")
    with environment_errors() as heard:
        assert call_within(5.0, cassette.find, exchange().key) is None
    other.close()
    assert heard == []


def test_a_text_is_found_by_what_it_is(recorded):
    assert Cassette(recorded, writable=False).text(text_digest("hello")) == "hello"


def test_the_listing_is_json_that_acts_on_no_terminal(recorded, capsys):
    cassette = Cassette(recorded, writable=True)
    cassette.add(exchange(HOSTILE, HOSTILE))
    cassette.close()
    assert main(["cassette", str(recorded)]) == 0
    told = capsys.readouterr().out
    assert all(one == "\n" or " " <= one <= "~" for one in told)
    described, first, second = map(json.loads, told.splitlines())
    assert described["described"]["model"] == "m"
    assert first["answer"]["text"] == "world"
    assert second["answer"]["text"] == HOSTILE
    assert second["request"]["messages"][1]["text"] == HOSTILE


def test_the_listing_of_something_else_is_one_error(tmp_path, capsys):
    assert main(["cassette", str(tmp_path / "none")]) == 2
    assert "there is no such cassette" in capsys.readouterr().err


def failed(text, failure):
    whole = exchange(text)
    return replace(whole, answer=Answer(failure=failure, detail="no", cause="HTTP 503"))


@pytest.fixture
def failing(recorded):
    cassette = Cassette(recorded, writable=True)
    for failure in ("unavailable", "timeout", "empty"):
        cassette.add(failed(failure, failure))
    cassette.add(failed("twice", "unavailable"))
    cassette.close()
    return recorded


def outcomes(tape):
    return [one.answer.failure for one in Cassette(tape, writable=False).exchanges()]


def test_failures_of_the_server_are_dropped_and_the_model_s_own_stay(failing, capsys):
    assert main(["cassette", str(failing), "--drop-failures"]) == 0
    told = capsys.readouterr().out
    assert told == "removed 2 exchanges that failed (2 unavailable); 3 are left\n"
    assert outcomes(failing) == ["", "timeout", "empty"]
    assert main(["cassette", str(failing), "--drop-failures"]) == 0
    assert "removed 0 exchanges" in capsys.readouterr().out


def test_other_classes_are_dropped_where_they_are_named(failing, capsys):
    classes = ["--class", "timeout", "--class=empty"]
    assert main(["cassette", str(failing), "--drop-failures", *classes]) == 0
    assert "removed 2 exchanges that failed (1 timeout, 1 empty); 3" in capsys.readouterr().out
    assert outcomes(failing) == ["", "unavailable", "unavailable"]
    assert main(["cassette", str(failing), *classes]) == 2
    assert "--drop-failures" in capsys.readouterr().err


def test_what_is_dropped_is_dropped_whole_or_not_at_all(failing, capsys):
    by_hand = sqlite3.connect(failing)
    by_hand.execute("UPDATE exchanges SET answer = '{' WHERE id = 5")
    by_hand.commit()
    by_hand.close()
    before = failing.read_bytes()
    assert main(["cassette", str(failing), "--drop-failures"]) == 2
    assert "cannot be written" in capsys.readouterr().err
    assert failing.read_bytes() == before


def test_nothing_is_made_where_there_is_nothing_to_drop(tmp_path, capsys):
    assert main(["cassette", str(tmp_path / "none"), "--drop-failures"]) == 2
    assert "there is no such cassette" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "change", ["cause', 5", "attempts', 0", "retry_after', 'x'", "waited', -1"]
)
def test_what_few_answers_have_is_checked_too(recorded, change):
    by_hand = sqlite3.connect(recorded)
    by_hand.execute(f"UPDATE exchanges SET answer = json_set(answer, '$.{change})")
    by_hand.commit()
    by_hand.close()
    with pytest.raises(ConfigurationError, match="of an answer"):
        list(Cassette(recorded, writable=False).exchanges())


def test_an_answer_without_anything_new_is_stored_as_ever():
    assert set(Answer("x").to_json()) == {
        "text", "failure", "detail", "seconds", "finish", "usage", "fingerprint"
    }  # fmt: skip
