"""The command that reports print for a replay of what a cassette holds."""

from __future__ import annotations

import pytest
from session_records import session_record

from pytest_dura.reports import summary
from pytest_dura.reports.gsn import yaml_file
from pytest_dura.reports.html import page
from pytest_dura.reports.wording import replay_options


@pytest.mark.parametrize(
    "command, told",
    [
        ("pytest", {}),
        ("pytest --dura-llm=live", {}),
        ("pytest --dura-llm=record", {"--dura-llm": "replay"}),
        ("pytest --dura-llm replay", {"--dura-llm": "replay"}),
        (
            "pytest --dura-llm=record '--dura-cassette=my tape'",
            {"--dura-llm": "replay", "--dura-cassette": "my tape"},
        ),
        ("pytest --dura-llm=record --dura-llm=live --dura-cassette=tape", {}),
        ("pytest --dura-llm", {}),
    ],
)
def test_what_was_recorded_is_replayed_from_its_cassette(command, told):
    assert replay_options(command) == told


def test_every_format_names_the_cassette_of_the_session():
    record = session_record(command="pytest --dura-llm=record '--dura-cassette=my tape'")
    words = "--dura-llm=replay --dura-cassette='my tape'"
    assert words in summary.render(record)
    assert words in yaml_file.render(record).replace("''", "'")
    assert words.replace("'", "&#39;") in "".join(page.render(record))
