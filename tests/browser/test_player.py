"""The episode player in a real browser."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from player_traces import (
    ASTRAY,
    BRAKING,
    GHOST,
    TICKS,
    UNSEEN,
    VERDICTS,
    VIOLATED_AT,
    crossing,
    without_scene,
)  # fmt: skip

from pytest_dura.core import Recording, Scene, Tracks
from pytest_dura.driving import MEASURES
from pytest_dura.evidence import Trace
from pytest_dura.execution import run_episode
from pytest_dura.library import expand_cases, load_library
from pytest_dura.reports import Twin, pack_data, player_assets, player_data, player_page

LAST = TICKS - 1
DRAWN = """
// What the canvas shows: strokes and texts since it was last cleared.
(() => {
  const {stroke, fillText, fillRect} = CanvasRenderingContext2D.prototype;
  window.drawn = {frames: 0, strokes: [], texts: []};
  CanvasRenderingContext2D.prototype.fillRect = function (...box) {
    Object.assign(window.drawn, {frames: window.drawn.frames + 1, strokes: [], texts: []});
    return fillRect.apply(this, box);
  };
  CanvasRenderingContext2D.prototype.stroke = function (...path) {
    window.drawn.strokes.push({dash: this.getLineDash().join(), style: this.strokeStyle});
    return stroke.apply(this, path);
  };
  CanvasRenderingContext2D.prototype.fillText = function (text, ...place) {
    window.drawn.texts.push(text);
    return fillText.call(this, text, ...place);
  };
})();
"""


@pytest.fixture(scope="module")
def html():
    measures = [one.info(place) for place, one in enumerate(MEASURES)]
    return player_page(crossing(), VERDICTS, measures)


@pytest.fixture(scope="module")
def shared(opened_once, html):
    return opened_once(html, script=DRAWN, clock=True)


@pytest.fixture
def page(shared):
    """A new player at tick 0, with a clock that the test moves."""
    shared.evaluate(
        """async () => {
          const at = document.getElementById("player");
          at.replaceChildren();
          const text = document.getElementById("episode").textContent;
          window.player = DuraPlayer.mount(at, text, {open: true, page: true});
          await window.player.open();
          window.opened = window.player.state.tick;
          window.player.seek(0);
        }"""
    )
    return shared


def ready(page):
    page.locator(".dura-player").wait_for()
    return page


def tick(page):
    return int(page.locator(".dura-player").get_attribute("data-tick"))


def seek(page, to):
    page.locator(".dura-scrub").fill(str(to))
    assert tick(page) == to


def press(page, name):
    page.get_by_role("button", name=name, exact=True).click()


def said(page, what):
    return page.locator(f"dd.dura-{what}").inner_text()


def seen(page):
    return page.get_by_role("img", name="Seen from above").get_attribute("aria-label")


# Time


def test_nothing_moves_before_play(page):
    page.clock.run_for(1000)
    assert tick(page) == 0


def test_play_advances_and_pause_holds(page):
    press(page, "Play")
    page.clock.run_for(1000)
    reached = tick(page)
    assert reached == pytest.approx(10, abs=1)
    press(page, "Pause")
    page.clock.run_for(1000)
    assert tick(page) == reached


@pytest.mark.parametrize("speed, ticks", [("0.25", 5), ("2", LAST)])
def test_speed(page, speed, ticks):
    page.get_by_role("combobox", name="Speed").select_option(speed)
    press(page, "Play")
    page.clock.run_for(2000)
    assert tick(page) == pytest.approx(ticks, abs=1)


def test_an_episode_of_hours_begins_at_a_speed_that_shows_it_within_two_minutes(opened):
    hours = without_scene()
    hours = replace(hours, time=hours.time * 6000.0)  # 41 ticks of 600 s
    page = ready(opened(player_page(hours, [], []), clock=True))
    speed = page.get_by_role("combobox", name="Speed")
    assert speed.input_value() == "512"
    assert speed.locator("option").last.get_attribute("value") == "2048"
    page.keyboard.press("l")
    page.keyboard.press("l")
    assert tick(page) == 2
    page.keyboard.press("j")
    assert tick(page) == 1
    press(page, "Play")
    page.clock.run_for(24000 * 1000 / 512)
    assert tick(page) == LAST


def test_play_ends_at_the_last_tick_and_then_begins_anew(page):
    seek(page, LAST - 2)
    press(page, "Play")
    page.clock.run_for(1000)
    assert tick(page) == LAST
    press(page, "Play")
    page.clock.run_for(300)
    assert 0 < tick(page) < 5


def test_steps_and_restart(page):
    seek(page, 7)
    press(page, "Step forward")
    assert tick(page) == 8
    press(page, "Step back")
    press(page, "Step back")
    assert tick(page) == 6
    press(page, "Restart")
    assert tick(page) == 0
    press(page, "Step back")
    assert tick(page) == 0


def test_keyboard(page):
    page.get_by_role("slider", name="time").focus()
    for key, to in [
        ("End", LAST), ("Home", 0), ("ArrowRight", 1), ("Shift+ArrowRight", 11), ("ArrowLeft", 10),
        ("n", 12), ("n", 20), ("p", 12), ("v", 36), ("Home", 0),
    ]:  # fmt: skip
        page.keyboard.press(key)
        assert (key, tick(page)) == (key, to)
    page.keyboard.press(".")
    assert page.get_by_role("combobox", name="Speed").input_value() == "2"
    page.keyboard.press("Space")
    page.clock.run_for(500)
    page.keyboard.press("Space")
    assert tick(page) == pytest.approx(10, abs=1)


def test_keys_work_wherever_the_focus_is_on_a_page_of_its_own(page):
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("ArrowRight")
    assert tick(page) == 1


def test_space_on_a_button_presses_that_button(page):
    page.get_by_role("button", name="Step forward").focus()
    page.keyboard.press("Space")
    assert tick(page) == 1
    page.clock.run_for(500)
    assert tick(page) == 1


def test_jump_to_the_violation(page):
    page.get_by_role("button", name="Jump to violation of SAF-1").click()
    assert tick(page) == round(VIOLATED_AT / 0.1)
    assert page.get_by_role("button", name="Jump to violation").count() == 1


def test_events_jump_and_the_current_one_is_marked(page):
    page.get_by_role("button", name=re.compile("alert")).click()
    assert tick(page) == 12
    current = page.locator("[aria-current=true]")
    assert "object_from_nowhere" in current.inner_text()
    seek(page, 30)
    assert "recovery" in current.inner_text()
    seek(page, 0)
    assert current.count() == 0


# The scene


def strokes(page):
    return {one["dash"] for one in page.evaluate("window.drawn.strokes")}


def labels(page):
    return page.evaluate("window.drawn.texts")


def test_ghosts_are_dashed_and_labelled(page):
    seek(page, GHOST[0])
    assert "6,4" in strokes(page)
    assert "GHOST (ghost)" in labels(page)
    assert "Ghosts: GHOST." in seen(page)
    seek(page, GHOST[0] - 1)
    assert "6,4" not in strokes(page)
    assert "Ghosts" not in seen(page)


def test_what_is_not_perceived_and_where_the_ego_believes_to_be(page):
    seek(page, UNSEEN[0])
    assert "V1 (not perceived)" in labels(page)
    assert "Not perceived: V1." in seen(page)
    seek(page, ASTRAY[0])
    assert "EGO (believed)" in labels(page)
    assert "Believes to be 3 m away" in seen(page)
    seek(page, 0)
    assert not any("(" in one for one in labels(page))


def test_layers_can_be_hidden(page):
    seek(page, GHOST[0])
    page.get_by_label("percept", exact=True).uncheck()
    assert "6,4" not in strokes(page)
    assert "V1" in labels(page)
    page.get_by_label("truth", exact=True).uncheck()
    assert "V1" not in labels(page)
    page.get_by_label("percept", exact=True).check()
    assert "V1 (perceived)" in labels(page)
    page.get_by_label("labels", exact=True).uncheck()
    assert [one for one in labels(page) if not one.endswith(" m")] == []


def test_the_scale_bar_follows_the_zoom(page):
    def metres():
        return int(labels(page)[-1].removesuffix(" m"))

    before = metres()
    for _ in range(6):
        press(page, "Zoom in")
    assert metres() < before
    for _ in range(12):
        page.get_by_role("img", name="Seen from above").press("-")
    assert metres() > before


def test_a_room_is_shown_as_large_as_a_road(opened):
    recording = crossing().recording
    tenth = [1 / 10, 1 / 10, 1, 1, 1 / 10, 1 / 10]
    scene = replace(
        recording.scene,
        lines=tuple(replace(line, points=line.points / 10) for line in recording.scene.lines),
        truth=replace(recording.scene.truth, poses=recording.scene.truth.poses * tenth),
        percept=replace(recording.scene.percept, poses=recording.scene.percept.poses * tenth),
    )

    def metres(trace):
        page = ready(opened(player_page(trace), script=DRAWN))
        return int(labels(page)[-1].removesuffix(" m"))

    assert metres(crossing()) == 10
    assert metres(crossing(recording=replace(recording, scene=scene))) == 2


@pytest.mark.parametrize("motion", ["reduce", "no-preference"])
def test_reduced_motion_draws_ticks_alone(page, motion):
    page.emulate_media(reduced_motion=motion)
    press(page, "Play")
    before = page.evaluate("window.drawn.frames")
    page.clock.run_for(500)
    frames = page.evaluate("window.drawn.frames") - before
    assert tick(page) >= 4
    assert (frames == tick(page)) == (motion == "reduce")


def test_a_real_episode_is_shown_as_it_was(opened):
    case = load_library(()).scenarios["intersection/ghost-obstacle"]
    (case,) = expand_cases([case])
    trace = Trace.of(run_episode(case.spec(0, 0, {}), recorded=True))
    page = ready(opened(player_page(trace)))
    scene = trace.recording.scene
    tracks = {
        name: dict(zip(side.ids, np.moveaxis(side.poses[:, :, 0], 1, 0), strict=True))
        for name, side in [("truth", scene.truth), ("percept", scene.percept)]
    }
    ghosts = 0
    for at in range(0, len(trace.time) - 1, 20):
        seek(page, at)
        assert said(page, "proposed") == trace.decisions["proposed"][at]
        assert said(page, "explanation") == trace.recording.explanations[at]
        there = {
            name: {one for one, x in side.items() if not np.isnan(x[at])}
            for name, side in tracks.items()
        }
        ghost = there["percept"] - there["truth"]
        told = re.search(r"Ghosts: (.*?)\.", seen(page))
        assert (set(told[1].split(", ")) if told else set()) == ghost
        ghosts += len(ghost)
    assert ghosts > 0


# The violation, and what the same seed comes to without something


def test_it_opens_three_seconds_before_the_violation(page):
    assert page.evaluate("window.opened") == round((VIOLATED_AT - 3) / 0.1)
    page.keyboard.press("v")
    assert tick(page) == round(VIOLATED_AT / 0.1)
    assert "at the violation of SAF-1" in page.locator(".dura-clock").inner_text()


def test_it_opens_at_the_beginning_of_what_violates_nothing(opened):
    page = ready(opened(player_page(crossing(), VERDICTS[1:])))
    assert tick(page) == 0


def test_the_worst_violation_is_that_of_safety_and_v_goes_on_from_it(opened):
    early = {**VERDICTS[0], "requirement": "PERF-9", "time": 1.0, "kind": "performance"}
    worst = {**VERDICTS[0], "kind": "safety"}
    page = ready(opened(player_page(crossing(), [early, worst])))
    assert tick(page) == 6
    reached = []
    for _ in range(3):
        page.keyboard.press("v")
        reached.append(tick(page))
    assert reached == [36, 10, 36]


def test_verdicts_are_folded_and_the_way_to_a_violation_is_not(page):
    assert not page.get_by_text("always (gap > 0)").first.is_visible()
    assert page.get_by_text("Verdicts: 1 violated, 1 satisfied, 1 invalid").is_visible()
    page.get_by_role("button", name="Jump to violation of SAF-1").click()
    assert tick(page) == round(VIOLATED_AT / 0.1)


def test_letters_play_and_move_by_a_second(page):
    assert "J" in page.locator(".dura-help kbd").all_inner_texts()
    page.keyboard.press("l")
    page.keyboard.press("l")
    assert tick(page) == 20
    page.keyboard.press("j")
    assert tick(page) == 10
    page.keyboard.press("k")
    assert page.evaluate("window.player.state.playing")
    page.keyboard.press("k")
    assert not page.evaluate("window.player.state.playing")


PARTED, ACTED, TWIN_ENDS = 12, 16, 30


def twin(without="faults"):
    """The same until 1.2 s, then another gap; from 1.6 s on another way; ended at 3 s."""
    trace = crossing()
    poses = trace.recording.scene.truth.poses.copy()
    poses[ACTED:, 0, 0] += np.arange(TICKS - ACTED) * 0.5
    executed = trace.decisions["executed"].copy()
    executed[ACTED:] = "slow"
    gap = trace.signals["gap"].copy()
    gap[PARTED:] += 1.0
    scene, end = trace.recording.scene, TWIN_ENDS + 1
    return Twin(without, replace(
        trace, time=trace.time[:end], about={**trace.about, "id": "a/crossing+none#0"},
        signals={name: (gap if name == "gap" else column)[:end]
                 for name, column in trace.signals.items()},
        decisions={name: (executed if name == "executed" else column)[:end - 1]
                   for name, column in trace.decisions.items()},
        recording=replace(trace.recording, scene=replace(
            scene, truth=Tracks(scene.truth.ids, poses[:end]))),
    ))  # fmt: skip


@pytest.fixture(scope="module")
def with_twin(opened_once):
    return ready(
        opened_once(player_page(crossing(), VERDICTS, twins=[twin()]), script=DRAWN, clock=True)
    )


def test_the_ego_of_the_same_seed_is_a_shadow(with_twin):
    page = with_twin
    dashes = "3,2"
    seek(page, ACTED + 8)
    assert dashes in [one["dash"] for one in page.evaluate("window.drawn.strokes")]
    assert "without faults" in page.evaluate("window.drawn.texts")
    seek(page, TWIN_ENDS + 1)
    assert dashes not in [one["dash"] for one in page.evaluate("window.drawn.strokes")]
    seek(page, 5)
    assert dashes in [one["dash"] for one in page.evaluate("window.drawn.strokes")]
    assert "without faults" not in page.evaluate("window.drawn.texts")  # it is where the ego is
    page.get_by_role("checkbox", name="without faults").uncheck()
    assert dashes not in [one["dash"] for one in page.evaluate("window.drawn.strokes")]
    page.get_by_role("checkbox", name="without faults").check()


def test_without_a_time_of_a_violation_it_opens_before_the_first_difference(opened):
    trace = crossing()
    page = ready(opened(player_page(trace, VERDICTS[1:], twins=[twin()])))
    assert tick(page) == 0  # it is less than 3 s from the beginning
    gap = trace.signals["gap"] + (np.arange(TICKS) >= 34)
    late = replace(trace, signals={**trace.signals, "gap": gap})
    page = ready(opened(player_page(trace, VERDICTS[1:], twins=[Twin("faults", late)])))
    assert tick(page) == 4


def test_the_first_difference_is_marked_and_said(with_twin):
    page = with_twin
    told = page.get_by_role("region", name="Same seed").inner_text()
    assert "differs first at 1.20 s: gap: " in told
    assert "acts otherwise from 1.60 s on: go 16 here, slow there" in told
    assert "ended by critical at 3.00 s" in told
    (place,) = page.locator(".dura-mark.dura-difference").evaluate_all(
        "(marks) => marks.map((one) => parseFloat(one.style.left))"
    )
    assert place == pytest.approx(100 * PARTED / LAST, abs=0.01)
    seek(page, 0)
    page.locator(".dura-player").focus()
    page.keyboard.press("d")
    assert tick(page) == PARTED
    lane = page.locator(".dura-row", has=page.locator(".dura-difference"))
    words = {}
    for at in (PARTED - 1, PARTED, ACTED + 2, TWIN_ENDS + 1):
        seek(page, at)
        words[at] = lane.locator(".dura-readout").inner_text()
    assert list(words.values()) == [
        "the same", "differs", "acts otherwise, 1 m apart", "has ended",
    ]  # fmt: skip


def test_a_twin_that_cannot_be_read_says_why(opened):
    page = ready(opened(player_page(crossing(), twins=[Twin("faults", None, "its file is gone")])))
    assert (
        "not shown: its file is gone" in page.get_by_role("region", name="Same seed").inner_text()
    )
    assert not page.get_by_role("checkbox", name="without faults").count()


# Panels and plots


def test_the_margin_of_what_has_to_come_about_is_grey_until_it_is_lost(opened):
    late = {**VERDICTS[0], "check": "eventually[0:2] (speed > 11)", "time": 2.0, "margin": -1.0}
    page = ready(opened(player_page(crossing(), [late])))
    plot = page.locator(".dura-row", has=page.locator(".dura-openline"))

    def ends(look):
        path = plot.locator(f"path.{look}").get_attribute("d")
        across = [float(x) for x in re.findall("[ML]([0-9.]+) ", path)]
        return across[0], across[-1]

    assert ends("dura-openline") == (0.0, 500.0)
    assert ends("dura-marginline") == (500.0, 1000.0)
    assert plot.locator("rect.dura-below").get_attribute("x") == "500"
    told = plot.get_by_role("img").get_attribute("aria-label")
    assert "not lost before 2.00 s" in told
    seek(page, 19)
    assert plot.locator(".dura-readout").inner_text().startswith("not lost yet, ")
    seek(page, 20)
    assert not plot.locator(".dura-readout").inner_text().startswith("not lost yet")


def test_the_decision_changes_with_the_tick(page):
    seek(page, 4)
    assert [said(page, one) for one in ("proposed", "executed", "source")] == [
        "go 4", "go 4", "proposal",
    ]  # fmt: skip
    assert said(page, "explanation") == "the way is clear at 4"
    seek(page, BRAKING[0])
    assert [said(page, one) for one in ("proposed", "executed", "source")] == [
        f"go {BRAKING[0]}", "brake", "recovery",
    ]  # fmt: skip
    assert said(page, "reasons") == "safety_monitor: too near"
    assert said(page, "recovery") == "brake: too near"
    seek(page, LAST)
    assert page.get_by_text("The last decision, at 3.90 s").is_visible()
    assert said(page, "proposed") == f"go {LAST - 1}"


def test_numbers_with_many_digits_are_rounded_and_others_are_not(opened):
    trace = crossing()
    texts = trace.decisions["proposed"].tolist()
    texts[0] = "Joints(shoulder=-0.4499999997221008, elbow=1.234567890123e-07)"
    texts[1] = "V12.3 at -0.12345678 m/s, x1.0000000001"
    trace = crossing(decisions=trace.decisions | {"proposed": np.array(texts, np.str_)})
    page = ready(opened(player_page(trace)))
    assert said(page, "proposed") == "Joints(shoulder=-0.45, elbow=1.23457e-7)"
    seek(page, 1)
    assert said(page, "proposed") == texts[1]


def row(page, name):
    return page.locator(".dura-row").filter(has=page.get_by_text(name, exact=True))


def test_monitors_say_what_holds_in_words_and_in_a_table(page):
    for at, word in [(0, "not asked"), (5, "safe"), (GHOST[0], "warning")]:
        seek(page, at)
        assert row(page, "security_assessor").locator(".dura-readout").inner_text() == word
    seek(page, BRAKING[0])
    assert row(page, "safety_monitor").locator(".dura-readout").inner_text() == "unsafe"
    page.get_by_text("Faults, control and monitors as a table").click()
    page.locator("tbody tr").first.wait_for()
    cells = [one.inner_text().split("\t") for one in page.locator("tbody tr").all()]
    assert ["safety_monitor", "unsafe", "2.50 s", "3.20 s"] in cells
    assert ["ghost", "fault active", "1.00 s", "2.00 s"] in cells


def test_flags_differ_in_more_than_colour(page):
    def shown(look):
        block = page.locator(f".dura-lanes .dura-{look}").first
        return block.evaluate(
            "one => [one.offsetHeight, getComputedStyle(one).backgroundImage !== 'none',"
            " one.textContent]"
        )

    looks = [shown(look) for look in ("safe", "warning", "unsafe", "silent")]
    assert len({look[0] for look in looks}) == 4
    assert [look[2] for look in looks] == ["", "W", "U", ""]


def test_the_cursor_is_where_the_slider_is(page):
    for at in (0, 13, LAST):
        seek(page, at)
        plot = row(page, "gap").locator(".dura-plot").bounding_box()
        cursor = row(page, "gap").locator(".dura-cursor").bounding_box()
        share = (cursor["x"] + cursor["width"] / 2 - plot["x"]) / plot["width"]
        assert share == pytest.approx(at / LAST, abs=0.002)
    seek(page, GHOST[0])
    assert row(page, "gap").locator(".dura-readout").inner_text() == "14.5, perceived 3"


def test_a_press_on_a_plot_goes_there(page):
    plot = row(page, "gap").locator(".dura-plot")
    box = plot.bounding_box()
    plot.click(position={"x": box["width"] * 0.5, "y": 20})
    assert tick(page) == LAST // 2


def test_signals_are_chosen(page):
    assert row(page, "gap").is_visible()  # the violated requirement speaks of it
    page.get_by_text("Choose plots").click()
    assert row(page, "collided").count() == 0
    page.get_by_role("checkbox", name="collided").check()
    seek(page, 36)
    assert row(page, "collided").locator(".dura-readout").inner_text() == "1"
    page.get_by_role("checkbox", name="gap").uncheck()
    assert row(page, "gap").count() == 0


def test_the_margin_of_what_was_violated_is_the_first_plot(page):
    first = page.locator(".dura-plots .dura-row").first
    assert first.locator(".dura-name").inner_text() == "margin of SAF-1"
    assert first.locator("code").inner_text() == "gap > 0"
    picture = first.get_by_role("img").get_attribute("aria-label")
    assert "least \N{MINUS SIGN}2 at 4.00 s" in picture
    assert "below zero this does not hold: gap > 0" in picture
    # What is below zero is told by more than its colour: there is a line at zero.
    assert first.locator(".dura-below").count() == first.locator(".dura-zero").count() == 1
    seek(page, TICKS - 1)
    assert first.locator(".dura-readout").inner_text() == "\N{MINUS SIGN}2"
    assert row(page, "margin of PERF-1").count() == 0
    page.get_by_text("Choose plots").click()
    page.get_by_role("checkbox", name="margin of PERF-1").check()
    assert row(page, "margin of PERF-1").locator(".dura-readout").inner_text() == "5"


def test_without_a_scene_there_are_plots_and_panels(opened):
    page = ready(opened(player_page(without_scene(), VERDICTS)))
    assert page.locator("canvas").count() == 0
    seek(page, 5)
    assert said(page, "proposed") == "go 5"
    assert row(page, "gap").is_visible()


@pytest.mark.parametrize("ticks", [0, 1])
def test_an_episode_that_ended_before_it_began(opened, ticks):
    empty = Tracks(("EGO",), np.zeros((ticks, 1, 6), np.float32))
    trace = crossing(
        about={"id": "a#0", "failure": "infrastructure: simulator: no <b>road</b>"},
        time=np.arange(ticks) * 0.1, signals={"gap": np.zeros(ticks)}, decisions={}, events=[],
        recording=Recording(scene=Scene((), empty, empty, "EGO")),
    )  # fmt: skip
    page = ready(opened(player_page(trace)))
    assert page.get_by_text("infrastructure: simulator: no <b>road</b>").is_visible()
    press(page, "Play")
    assert page.get_by_role("button", name="Play").is_visible()


# For everybody


def test_each_control_has_a_name_and_a_role(page):
    tree = page.context.new_cdp_session(page).send("Accessibility.getFullAXTree")["nodes"]
    found = {}
    for node in tree:
        role = node.get("role", {}).get("value")
        if not node["ignored"]:
            found.setdefault(role, []).append(node.get("name", {}).get("value", ""))
    for role, least in [("button", 8), ("checkbox", 4), ("slider", 1), ("combobox", 1),
                        ("image", 4)]:  # fmt: skip
        assert len(found[role]) >= least
        assert all(name.strip() for name in found[role]), (role, found[role])
    assert found["slider"] == ["time"]
    assert {"Play", "Restart", "Step back", "Step forward", "Zoom in"} <= set(found["button"])


def test_the_slider_tells_time_and_tick(page):
    seek(page, 12)
    slider = page.get_by_role("slider", name="time")
    assert slider.get_attribute("aria-valuetext") == f"1.20 s, tick 12 of {LAST}"


def test_a_screen_reader_hears_where_it_ends_and_not_each_tick(page):
    page.evaluate(
        "window.told = []; new MutationObserver(() => window.told.push("
        "document.querySelector('[role=status]').textContent)).observe("
        "document.querySelector('[role=status]'), {childList: true})"
    )
    press(page, "Step forward")
    press(page, "Play")
    page.clock.run_for(2700)
    assert page.evaluate("window.told") == []
    press(page, "Pause")
    page.clock.run_for(400)
    (told,) = page.evaluate("window.told")
    assert told.startswith("Paused. 2.")
    assert "executed brake, from recovery" in told
    assert "safety_monitor says unsafe" in told


def test_focus_is_visible(page):
    for _ in range(12):
        page.keyboard.press("Tab")
        outline = page.evaluate("getComputedStyle(document.activeElement).outlineWidth")
        assert outline == "3px"


CONTRAST = """
() => {
  const numbers = (colour) => colour.match(/[\\d.]+/g).map(Number);
  const light = ([r, g, b]) => [r, g, b].map((one) => one / 255)
    .map((one) => (one <= 0.04045 ? one / 12.92 : ((one + 0.055) / 1.055) ** 2.4))
    .reduce((sum, one, index) => sum + one * [0.2126, 0.7152, 0.0722][index], 0);
  const behind = (node) => {
    for (let one = node; one; one = one.parentElement) {
      const style = getComputedStyle(one);
      if (style.backgroundImage !== "none") return null;
      const [r, g, b, a = 1] = numbers(style.backgroundColor);
      if (a > 0) return [r, g, b];
    }
    return null;
  };
  const found = [];
  const walker = document.createTreeWalker(document.querySelector(".dura-player"),
    NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const node = walker.currentNode.parentElement;
    const back = behind(node);
    if (!walker.currentNode.data.trim() || !back || node.closest("option")) continue;
    const [one, other] = [light(numbers(getComputedStyle(node).color)), light(back)];
    const ratio = (Math.max(one, other) + 0.05) / (Math.min(one, other) + 0.05);
    found.push([ratio, node.className, walker.currentNode.data.slice(0, 40)]);
  }
  return found.sort((one, other) => one[0] - other[0]);
}
"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_contrast(page, scheme):
    page.emulate_media(color_scheme=scheme)
    seek(page, BRAKING[0])
    page.get_by_text("Choose plots").click()
    found = page.evaluate(CONTRAST)
    assert len(found) > 80
    assert found[0][0] >= 4.5, found[0]
    back = page.evaluate("getComputedStyle(document.querySelector('.dura-player')).backgroundColor")
    assert (back == "rgb(255, 255, 255)") == (scheme == "light")


HOSTILE = "</script><script>window.pwned=1</script><img src=x onerror=window.pwned=1>"


def hostile_page():
    many = TICKS - 1
    trace = crossing()
    scene = trace.recording.scene
    ids = ("EGO", HOSTILE)
    texts = np.array([HOSTILE + "x" * 5000] * many)
    return player_page(
        crossing(
            about=dict.fromkeys(trace.about, HOSTILE) | {"failure": HOSTILE * 100},
            signals={HOSTILE: trace.time, "gap": trace.time, "__proto__": trace.time},
            decisions=trace.decisions | {"proposed": texts, "source": texts},
            events=[
                {"tick": 0, "time": 0, "kind": HOSTILE, "subject": HOSTILE, "detail": "\u202e" * 99}
            ],
            recording=Recording(
                tuple([HOSTILE] * many), tuple(texts), tuple(["y" * 3000] * many),
                {HOSTILE: np.zeros(many, np.int8), "constructor": np.full(many, 7, np.int8)},
                Scene(scene.lines, Tracks(ids, scene.truth.poses), scene.truth, ids[1]),
                problem=HOSTILE,
            ),
        ),
        [dict.fromkeys(("requirement", "verdict", "check"), HOSTILE)
         | {"time": 1.0, "margin": float("nan")}],
    )  # fmt: skip


def test_hostile_texts_stay_texts_and_within_the_page(opened):
    page = ready(opened(hostile_page()))
    page.get_by_text("Choose plots").click()
    page.get_by_text("Faults, control and monitors as a table").click()
    assert said(page, "explanation") == HOSTILE
    assert page.evaluate("window.pwned") is None
    assert page.locator(".dura-player").locator("script, img").count() == 0
    for width in (360, 640, 900, 1280):
        page.set_viewport_size({"width": width, "height": 700})
        assert page.evaluate("document.documentElement.scrollWidth") == width


@pytest.mark.parametrize("width", [360, 640, 1280])  # 640: a desktop's page at 200 %
def test_it_fits_without_sideways_scrolling(page, width):
    page.set_viewport_size({"width": width, "height": 740})
    assert page.evaluate("document.documentElement.scrollWidth") == width
    box = page.locator(".dura-stage").bounding_box()
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= width


def test_the_policy_stops_what_escaping_would_not(opened, html):
    broken = html.replace("<main", HOSTILE.removeprefix("</script>") + "<main")
    opened.expected += ["Content Security Policy"]
    page = ready(opened(broken))
    assert page.evaluate("window.pwned") is None
    assert sum("Content Security Policy" in one for one in opened.problems) >= 2


# Several players, and bad data

SHELL = """<!doctype html><meta charset="utf-8"><title>players</title><style>{style}</style>
<div id="a"></div><div id="b"></div><script>{script}
const text = {text};
window.read = 0;
window.a = DuraPlayer.mount(document.getElementById("a"),
  () => {{ window.read += 1; return text; }});
window.b = DuraPlayer.mount(document.getElementById("b"), text, {{label: "Show b", level: 3}});
</script>"""


def several(text):
    script, style = player_assets()
    return SHELL.format(style=style, script=script, text=repr(text))


def test_nothing_is_unpacked_before_it_is_opened(opened):
    page = opened(several(pack_data(player_data(crossing()))))
    assert page.evaluate("[window.read, window.a.state]") == [0, None]
    page.get_by_role("button", name="Open the episode player").click()
    ready(page)
    assert page.evaluate("window.read") == 1
    assert page.evaluate("document.activeElement.ariaLabel") == "Episode player: a/crossing#0"
    at = tick(page)
    page.keyboard.press("ArrowRight")
    assert tick(page) == at + 1
    assert page.locator(".dura-player").count() == 1


BESIDE = SHELL.replace("{{label:", "{{others: () => [{{label: 'late', packed: {late}}}], label:")


def test_episodes_stand_beside_each_other_at_the_same_time_before_their_violation(opened):
    script, style = player_assets()
    verdicts = [dict(VERDICTS[0], time=1.6)]
    late = player_data(crossing(about={**crossing().about, "id": "late"}), VERDICTS)
    own = pack_data(player_data(crossing(), verdicts))
    page = opened(BESIDE.format(style=style, script=script, text=repr(own),
                                late=repr(pack_data(late))))  # fmt: skip
    page.evaluate("window.b.open()")
    page.get_by_role("button", name="Show beside").click()
    beside = page.get_by_role("region", name="Beside: late")
    beside.wait_for()
    times = {}
    for at in (16, 6, 21, 36):
        page.evaluate("(at) => window.b.seek(at)", at)
        times[at] = beside.locator(".dura-clock").inner_text()
    assert times == {
        16: "3.60 s, at the violation of SAF-1",
        6: "2.60 s, 1.00 s before the violation of SAF-1",
        21: "4.00 s, 0.40 s after the violation of SAF-1, ended",
        36: "4.00 s, 0.40 s after the violation of SAF-1, ended",
    }
    page.evaluate("window.b.seek(16)")
    assert "EGO at (2, \N{MINUS SIGN}6) m" in beside.get_by_role("img").get_attribute("aria-label")
    beside.get_by_role("button", name="Remove late").click()
    assert not beside.count()
    assert page.evaluate("document.activeElement.textContent") == "Show beside"


def test_only_one_player_plays(opened):
    page = opened(several(pack_data(player_data(crossing()))))
    page.evaluate("Promise.all([window.a.open(), window.b.open()])")
    page.evaluate("window.a.play()")
    assert page.evaluate("[window.a.state.playing, window.b.state.playing]") == [True, False]
    page.evaluate("window.b.play()")
    assert page.evaluate("[window.a.state.playing, window.b.state.playing]") == [False, True]
    ids = page.evaluate("Array.from(document.querySelectorAll('[id]'), (one) => one.id)")
    assert len(ids) == len(set(ids))
    page.evaluate("window.b.seek(12)")
    state = page.evaluate("window.b.state")
    assert (state["tick"], state["playing"], state["ghosts"]) == (12, False, ["GHOST"])


@pytest.mark.parametrize("text", ["", "%%%", "eJwDAAAAAAE=", pack_data({})])
def test_bad_data_is_told(page, text):
    page.evaluate("(text) => DuraPlayer.mount(document.getElementById('player'), text)", text)
    page.get_by_role("button", name="Open the episode player").click()
    assert "cannot be shown" in page.get_by_role("alert").inner_text()
