"""A whole session of hostile texts in a real browser: nothing runs or loads, nothing breaks."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hostile_bundles import SORTS, Spoiler, real_session, session

from pytest_dura.evidence import read_trace
from pytest_dura.reports import player_page
from pytest_dura.reports.html.page import render

FIRST = (
    "<img src=x onerror=window.pwned=1>", "__proto__", "constructor", "'\"><svg onload=pwned=1>",
    "javascript:window.pwned=1", "</script><script>window.pwned=1</script>", "%s{{x}}${x}`",
)  # fmt: skip
EACH_SORT = "".join(map("".join, SORTS))
POOL = [
    *FIRST,
    *(f"{number}{one}{EACH_SORT}" for number in range(9) for one in FIRST if "<" in one),
]
"""Most are markup: which of them a given place of the page comes to show is left to chance."""
PWNED = """() => {
  const found = [...document.querySelectorAll("img")].map((one) => one.outerHTML);
  for (const name in {}) found.push(name);  // what reached the prototype of all objects
  return window.pwned === undefined ? found : [...found, "ran"];
}"""


@pytest.fixture(scope="module")
def hostile(tmp_path_factory):
    """The record, and the first of its traces that has decisions."""
    folder = tmp_path_factory.mktemp("hostile")
    record = session(real_session(folder / "project"), folder / "bundle", Spoiler(POOL))
    traces = (entry.trace.file for entry in record.episodes() if entry.trace)
    found = (read_trace(record.directory / file) for file in traces)
    return record, next(one for one in found if len(one.time) > 2)


def unfolded(page):
    """Opens each folded part of the page; how many there were."""
    return page.evaluate("""() => {
      const folded = [...document.querySelectorAll("details:not([open])")];
      for (const one of folded) one.open = true;
      return folded.length;
    }""")


def pressed(page, buttons):
    """Presses each of these buttons; how many there were."""
    found = page.locator(buttons).all()
    for one in found:
        one.evaluate("one => one.click()")
    page.wait_for_timeout(100)
    return len(found)


def test_the_report_of_a_hostile_session_runs_nothing(opened, hostile):
    page = opened(render(hostile[0]))
    # All views and players at once, as where no script runs.
    page.evaluate("document.documentElement.classList.remove('js')")
    slots = page.locator("details.player .slot").all()
    assert len(slots) >= 2
    assert page.locator(".dura-player").count() == 0
    assert unfolded(page) > len(slots)
    for (
        slot
    ) in slots:  # a player is made when its episode is unfolded, and has its own folded parts
        slot.locator(".dura-player").wait_for()
        assert "The episode cannot be shown" not in slot.inner_text()
    assert unfolded(page) >= len(slots)
    assert pressed(page, ".dura-player button") > len(slots)
    assert pressed(page, "a[href^='#']") > 20
    assert page.evaluate(PWNED) == []
    assert page.locator("script").count() == 3 + page.locator("details.player").count()
    assert "<img src=x onerror=window.pwned=1>" in page.locator("main").inner_text()
    page.get_by_label("Filter", exact=True).first.fill("<img src=x onerror=window.pwned=1>")
    assert page.evaluate(PWNED) == []


def test_the_player_of_a_hostile_episode_runs_nothing(opened, hostile):
    verdicts = [{"requirement": one, "verdict": one, "check": one, "time": 0.1} for one in POOL]
    about = {**hostile[1].about, "id": f"</title>{FIRST[0]}", "failure": FIRST[0]}
    page = opened(player_page(replace(hostile[1], about=about), verdicts))
    page.locator(".dura-player").wait_for()
    assert FIRST[0] in page.title()
    assert unfolded(page) > 0
    assert pressed(page, ".dura-player button") > 0
    for key in ("ArrowRight", "ArrowRight", "End", "Home", " ", " "):
        page.keyboard.press(key)
    assert page.evaluate(PWNED) == []
    assert page.locator(".dura-player").locator("script, img, a[href]").count() == 0
    assert "onerror=window.pwned=1" in page.locator(".dura-player").inner_text()
