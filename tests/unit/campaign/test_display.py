"""What objects show of themselves, in a console and in a notebook, without IPython."""

from __future__ import annotations

import dataclasses
import inspect
import sys
from html.parser import HTMLParser

import numpy as np
import pytest
from campaign_rooms import rooms
from handmade import SPEC, handmade
from session_records import session_record

import pytest_dura
from pytest_dura.core.display import LONGEST_REPR, Shown, short_repr, table_html
from pytest_dura.plugin.items.observed_episode import ObservedEpisode, observations_of

HOSTILE = "<script>alert('x')</script>\"&\x1b[31m\n\u202e\udc80" + "long " * 300


class Reader(HTMLParser):
    """Reads a table, and refuses what is not well formed or not ours."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.open, self.cells = [], []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        assert tag in ("table", "caption", "tr", "th", "td", "br")
        assert not attrs
        if tag != "br":
            self.open.append(tag)
            self.cells += [""] if tag in ("caption", "th", "td") else []

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.cells[-1] += data


def spoilt(value):
    """Put a hostile text into every text of a dataclass, as far as it goes."""
    changes = {
        field.name: HOSTILE
        for field in dataclasses.fields(value)
        if field.init and isinstance(getattr(value, field.name), str)
    }
    return dataclasses.replace(value, **changes)


def shown_objects(folder):
    runner = rooms(folder)
    episode = runner.run("room/it", seed=3)
    campaign = runner.campaign("room/it")
    requirement = runner.library().requirements["COLD-1"]
    verdict = campaign.judge(requirement)
    searched = campaign.falsify("always (temperature < 99)", budget=5, shrink=0)
    yield from (episode, ObservedEpisode.of(episode), campaign, requirement, verdict, searched)
    yield from (campaign.paired("recovery_planner"), runner.case("room/it"), session_record())
    yield pytest_dura.EpisodeVerdict(
        **{**EPISODE_VERDICT, "detail": HOSTILE, "episode": HOSTILE, "requirement": HOSTILE}
    )
    yield handmade(3, spec=dataclasses.replace(SPEC, case=HOSTILE), failure=HOSTILE)
    yield from map(spoilt, (requirement, verdict, searched))


EPISODE_VERDICT = {
    "requirement": "R-1", "episode": "a#0", "component": "C", "verdict": "violated",
    "margin": -0.5, "time": 1.0, "detail": "hit", "proposals": 3, "valid_proposals": 3,
}  # fmt: skip


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    return list(shown_objects(tmp_path_factory.mktemp("rooms")))


def test_notebooks_show_tables_that_are_escaped(shown):
    assert "IPython" not in sys.modules
    for value in shown:
        text = value._repr_html_()
        reader = Reader(text)
        assert reader.cells[0] == type(value).__name__
        assert len(reader.cells) > 3
        assert all(cell.isprintable() for cell in reader.cells)
        assert "<script" not in text
        text.encode()


def test_hostile_texts_are_shown_as_what_they_are(shown):
    text = "".join("".join(Reader(value._repr_html_()).cells) for value in shown)
    assert "<script>alert('x')</script>\"&\\x1b[31m \\u202e\\udc80long" in text


def test_a_verdict_shows_what_it_says(shown):
    (verdict,) = [v for v in shown if type(v).__name__ == "CampaignVerdict" and len(v.case) < 99]
    cells = Reader(verdict._repr_html_()).cells
    rows = dict(zip(cells[1::2], cells[2::2], strict=True))
    assert rows["requirement"] == "COLD-1"
    assert rows["verdict"] == "supported"
    assert rows["runs"] == "3 of 3, 3 valid"
    assert float(rows["rate at most, at 0.95 confidence"]) == pytest.approx(
        verdict.bound.upper, rel=1e-3
    )


def test_reprs_are_one_short_line(shown):
    for value in [*shown, *(value.spec for value in shown if hasattr(value, "spec"))]:
        text = repr(value)
        assert len(text) <= LONGEST_REPR, text
        assert text.isprintable()


def test_looking_at_an_episode_in_a_notebook_reads_nothing_of_it(shown):
    (observed,) = [value for value in shown if isinstance(value, ObservedEpisode)]
    repr(observed), observed._repr_html_()
    assert not observations_of(observed).names


def test_showing_a_campaign_simulates_nothing(tmp_path):
    from campaign_rooms import CountedRoom

    campaign = rooms(tmp_path).campaign("room/it")
    repr(campaign), campaign._repr_html_()
    assert CountedRoom.seeds == []


def public_classes():
    values = (getattr(pytest_dura, name) for name in pytest_dura.__all__ if name[:2] != "__")
    return [value for value in values if inspect.isclass(value)]


def test_no_public_class_has_the_endless_repr_of_dataclasses():
    for kind in filter(dataclasses.is_dataclass, public_classes()):
        assert not hasattr(kind.__repr__, "__wrapped__"), kind


def test_every_public_dataclass_describes_hostile_values_shortly():
    kinds = [kind for kind in public_classes() if kind.__repr__ is short_repr]
    assert len(kinds) > 20
    for kind in filter(dataclasses.is_dataclass, kinds):
        value = object.__new__(kind)
        for field in dataclasses.fields(kind):
            object.__setattr__(value, field.name, HOSTILE)
        text = repr(value)
        assert len(text) <= LONGEST_REPR
        assert text.isprintable()
        assert text.startswith(kind.__name__ + "(")


@dataclasses.dataclass
class Mixed:
    name: str
    array: object = None
    number: int = 3
    texts: tuple = ()
    more: dict = dataclasses.field(default_factory=dict)

    __repr__ = short_repr


def test_a_repr_shows_what_differs_from_defaults():
    assert repr(Mixed("a")) == "Mixed(name='a')"
    assert repr(Mixed("a", np.zeros((3, 4)), 3, ("b",))) == (
        "Mixed(name='a', array=array(3, 4), texts=('b',))"
    )
    assert repr(Mixed("a", more={"k": 1}, number=4)) == "Mixed(name='a', number=4, more={'k': 1})"
    assert repr(Mixed("a" * 99, "b" * 99, more={"k": 1})).endswith("...)")


def test_a_table_leaves_out_what_there_is_not():
    text = table_html("T", [("a", None), ("b", ""), ("c", 0.123456), ("d", list("xyz"))])
    assert text == (
        "<table><caption>T</caption><tr><th>c</th><td>0.1235</td></tr>"
        "<tr><th>d</th><td>x<br>y<br>z</td></tr></table>"
    )
    assert "and 90 more" in table_html("T", [("many", ["x"] * 100)])


def test_all_that_is_shown_is_public():
    kinds = {kind for kind in public_classes() if issubclass(kind, Shown)}
    assert {kind.__name__ for kind in kinds} >= {
        "Campaign", "CampaignVerdict", "Case", "Episode", "EpisodeVerdict", "Falsification",
        "JudgedEpisode", "PairedCampaign", "Requirement",
    }  # fmt: skip
