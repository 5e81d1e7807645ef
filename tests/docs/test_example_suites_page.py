"""The page on example suites: each suite stands in its table, each case that it shows replays."""

from __future__ import annotations

import re

from suites import REPOSITORY, SUITES

TEXT = (REPOSITORY / "docs" / "example-suites.md").read_text()


def test_each_suite_is_named_by_its_folder():
    folders = {folder.name for folder in SUITES.iterdir() if (folder / "README.md").is_file()}
    assert set(re.findall(r"\(\.\./example_suites/(\w+)\)", TEXT)) == folders


def test_each_counterexample_is_shown_with_a_replay_of_equal_digest():
    shown = re.findall(r"^falsified: (\S+) on", TEXT, flags=re.MULTILINE)
    replayed = re.findall(r"--dura-replay='found/\S*?-([A-Z]+-\d)-\w+#0'", TEXT)
    assert len(shown) == 5
    assert replayed == shown
    assert TEXT.count("\n  the same\n") == 5
