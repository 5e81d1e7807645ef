"""Pages of four sessions of the built-in scenarios, in a real browser, at three widths."""

from __future__ import annotations

import os
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

pytestmark = pytest.mark.of_guest
ROOT = Path(__file__).parents[2]
SESSIONS = {
    "green": "intersection/nominal --dura-runs=2",
    "tactical": "intersection/pedestrian-crossing --dura-runs=4 --dura-generator=tactical",
    "aggressive": "*/sudden/two-conflicts* --dura-runs=2 --dura-generator=aggressive",
    "catalogue": "intersection/nominal --dura-runs=1 --dura-generator=tactical"
    " --dura-faults=brightness,class-change,out-of-range",
}
"""Scenario and options of each, smaller than those of ``docs/screenshots.py``."""
HEIGHTS = {1400: 900, 900: 900, 390: 844}
SCHEMES = {1400: "light", 900: "dark", 390: "dark"}
EVERY_VIEW = """() => {
  for (const view of document.querySelectorAll(".view")) view.classList.add("current");
  dispatchEvent(new Event("resize"));
  return new Promise((next) => requestAnimationFrame(() => requestAnimationFrame(next)));
}"""
FOCUSED = """() => {
  const one = document.activeElement;
  const { outlineStyle, outlineWidth } = getComputedStyle(one);
  const rect = one.getBoundingClientRect();
  one.dataset.reached = "";
  return {
    tag: one.tagName, text: one.textContent.trim().slice(0, 60), width: rect.width,
    seen: outlineStyle === "solid" && parseFloat(outlineWidth) >= 2,
    inside: rect.bottom > 0 && rect.top < innerHeight,
  };
}"""
NOT_REACHED = """() => [...document.querySelectorAll(
    "a, button, input, select, summary, [tabindex='0']")]
  .filter((one) => one.checkVisibility() && !one.disabled && one.dataset.reached === undefined)
  .map((one) => one.outerHTML.slice(0, 120))"""
WIDE = """() => [...document.querySelectorAll(".scroll:has(> table)")]
  .filter((box) => box.checkVisibility() && box.scrollWidth > box.clientWidth + 1)
  .map((box) => box.firstElementChild.id)"""


@dataclass(frozen=True)
class Report:
    """The page of a session, and what its process ended with."""

    html: str
    exit_code: int


@pytest.fixture(scope="module")
def reports(browser, tmp_path_factory, forked_workers):
    """Reports by the names of their sessions, which run side by side."""
    folder = tmp_path_factory.mktemp("sessions")
    environment = {**os.environ, "PYTHONHASHSEED": "0"}
    running = {}
    for name, options in SESSIONS.items():
        arguments = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "--dura-scenarios"]
        arguments += [f"--dura-evidence={folder / name}", "--dura-executor=in-process"]
        running[name] = subprocess.Popen(
            [*forked_workers.command(*arguments), *f"--dura-select={options}".split()],
            cwd=ROOT,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
    printed = {name: process.communicate(timeout=300)[0] for name, process in running.items()}
    for name in SESSIONS:
        assert (folder / name / "report.html").exists(), printed[name]
    return {
        name: Report((folder / name / "report.html").read_text("utf-8"), process.returncode)
        for name, process in running.items()
    }


def views_of(page):
    return [link.get_attribute("href")[1:] for link in page.locator("nav a").all()]


def show(page, view):
    page.evaluate("view => { location.hash = view }", view)
    page.locator(f"#{view}.current").wait_for()


@pytest.mark.parametrize("name", SESSIONS)
def test_axe_finds_no_barrier_at_any_width_in_light_and_dark(opened, axe, reports, name):
    problems = {}
    for width, scheme in SCHEMES.items():
        window = {"width": width, "height": HEIGHTS[width]}
        page = opened(reports[name].html, viewport=window, color_scheme=scheme)
        # One view at a time has its own test; here the rules go over all of them at once.
        page.evaluate(EVERY_VIEW)
        for found in axe.run(page).response["violations"]:
            nodes = [node["html"][:200] for node in found["nodes"]]
            problems.setdefault(found["id"], []).append((width, scheme, nodes[:3]))
        page.context.close()
    assert problems == {}


@pytest.mark.parametrize("name", SESSIONS)
def test_no_page_and_no_table_is_wider_than_its_window(opened, reports, name):
    for width, height in HEIGHTS.items():
        page = opened(reports[name].html, viewport={"width": width, "height": height})
        for view in views_of(page):
            show(page, view)
            beyond = page.evaluate("document.documentElement.scrollWidth - innerWidth")
            assert (beyond, page.evaluate(WIDE)) == (0, []), (width, view)
        page.context.close()


@pytest.mark.parametrize("name", ["tactical", "aggressive", "catalogue"])
@pytest.mark.parametrize("width", HEIGHTS)
def test_the_first_screen_says_what_failed_how_often_by_how_much_and_how_to_see_it(
    opened, reports, name, width
):
    report = reports[name]
    assert report.exit_code == 1
    page = opened(report.html, viewport={"width": width, "height": HEIGHTS[width]})
    card = page.locator(".card").first
    card_text = card.inner_text()
    first = card.locator("dd").first
    assert " of " in first.inner_text(), "how often"
    assert any(unit in card_text for unit in (" s ", " m ", " m/s")), "by how much"
    shown = [page.locator(".gate"), page.locator(".sentence"), card.locator("h3"), first]
    shown += [card.locator(".button")] if card.locator(".button").count() else []
    for each in shown:
        box = each.bounding_box()
        assert box["y"] >= 0, each
        assert box["y"] + box["height"] <= HEIGHTS[width], each


@pytest.mark.parametrize("width", [1400, 390])
def test_keys_reach_each_link_card_and_filter_and_one_sees_where_they_are(opened, reports, width):
    page = opened(reports["aggressive"].html, viewport={"width": width, "height": HEIGHTS[width]})
    for view in ("overview", "requirements", "episodes"):
        show(page, view)
        rounds = 0
        while rounds < 2:  # the first one begins where the view has the focus
            page.keyboard.press("Tab")
            focused = page.evaluate(FOCUSED)
            if focused["tag"] == "BODY":
                rounds += 1
                continue
            assert (focused["seen"], focused["inside"]) == (True, True), (view, focused)
        assert page.evaluate(NOT_REACHED) == [], view


def test_keys_open_a_view_a_card_and_its_player(opened, reports):
    page = opened(reports["aggressive"].html)
    link = page.locator("nav a", has_text="Cases")
    link.focus()
    page.keyboard.press("Enter")
    page.locator("#cases.current").wait_for()
    show(page, "overview")
    page.locator(".card .button").first.focus()
    page.keyboard.press("Enter")
    page.locator(".dura-player:focus").wait_for()
    style = "getComputedStyle(document.activeElement)"
    assert page.evaluate(f"{style}.outlineStyle") == "solid"
    before = page.locator(".dura-clock").inner_text()
    page.keyboard.press("v")
    assert "at the violation of" in page.locator(".dura-clock").inner_text() != before
