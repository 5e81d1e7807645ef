from __future__ import annotations

import pytest
from hypothesis import given, settings
from traces import TEXTS

from pytest_dura.evidence import episode_name, is_trace_path, trace_path
from pytest_dura.evidence.traces import is_trace_name, slug

ABOUT = {"id": "a/clear+ghost#3", "component": "C", "seed": 1, "digest": "d" * 64}


def test_a_name_reads_like_the_episode():
    name = episode_name(ABOUT)
    assert name[:-9] == "a-clear-ghost-3"
    assert trace_path(ABOUT) == f"episodes/{name}.mcap"


@pytest.mark.parametrize("key", list(ABOUT))
def test_whatever_tells_episodes_apart_tells_their_names_apart(key):
    assert episode_name(ABOUT | {key: "other"}) != episode_name(ABOUT)


@pytest.mark.parametrize(
    "text, name",
    [
        ("../../etc/passwd", "etc-passwd"), ("..", "episode"), ("a..b", "a.b"), ("", "episode"),
        (".hidden", "hidden"), ("-rf", "rf"), ("CON.x", "_CON.x"), ("nul", "_nul"),
        ("lpt1", "_lpt1"), ("console", "console"), ("x" * 90, "x" * 80), ("a\x00\nb", "a-b"),
        ("été", "t"), ("C:\\x", "C-x"),
    ],
)  # fmt: skip
def test_names_are_harmless(text, name):
    assert slug(text) == name


@settings(derandomize=True, deadline=None, max_examples=200)
@given(TEXTS)
def test_each_name_is_known_as_ours(text):
    about = ABOUT | {"id": text, "component": text}
    assert is_trace_name(f"{episode_name(about)}.mcap")
    assert is_trace_path(trace_path(about))


@pytest.mark.parametrize(
    "path",
    [
        "episodes/../x-0123abcd.mcap", "../episodes/x-0123abcd.mcap", "/x-0123abcd.mcap",
        "episodes/x.mcap", "episodes/a/x-0123abcd.mcap", "episodes/a..b-0123abcd.mcap",
        "episodes/.x-0123abcd.mcap", "episodes/x-0123abcd.mcap\n", "episodes\\x-0123abcd.mcap",
        "episodes/x-0123ABCD.mcap", None, 3,
    ],
)  # fmt: skip
def test_other_paths_are_not(path):
    assert not is_trace_path(path)
