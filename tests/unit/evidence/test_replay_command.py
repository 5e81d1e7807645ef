"""The command that formats print: where the evidence is, as far as the session's command tells."""

from __future__ import annotations

import shlex

import pytest
from session_records import session_record

from pytest_dura.reports import summary
from pytest_dura.reports.gsn import yaml_file
from pytest_dura.reports.wording import evidence_option, replay_command


@pytest.mark.parametrize(
    "command, directory",
    [
        ("pytest --dura-scenarios", None),
        ("pytest --dura-evidence=out --dura-scenarios", "out"),
        ("pytest --dura-evidence out --dura-scenarios", "out"),
        ("pytest '--dura-evidence=my out'", "my out"),
        ("pytest --dura-evidence 'my out'", "my out"),
        ("pytest --dura-evidence=a=b", "a=b"),
        ("pytest --dura-evidence=first --dura-evidence last", "last"),
        ("pytest --dura-evidence-level=all", None),
        ("pytest --dura-evidence", None),
        ("pytest '--dura-evidence=out", None),
        ("", None),
        (" \n", None),
        ("pytest " + "x" * 200_000 + " --dura-evidence=out", None),
    ],
)
def test_the_directory_is_that_of_the_session(command, directory):
    assert evidence_option(command) == directory


@pytest.mark.parametrize("text", ["a/b#1", "it's", "$(reboot)", "a b", ""])
def test_each_value_is_one_word_for_a_shell(text):
    assert shlex.split(replay_command(text, text)) == [
        "pytest", f"--dura-replay={text}", f"--dura-evidence={text}"
    ]  # fmt: skip


@pytest.mark.parametrize("render", [summary.render, yaml_file.render])
def test_formats_name_a_directory_that_was_given_as_a_word_of_its_own(render):
    text = render(session_record(command="pytest --dura-scenarios --dura-evidence out"))
    assert "--dura-evidence=out" in text
