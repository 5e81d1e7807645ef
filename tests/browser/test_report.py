"""The report in a real browser: quiet, readable and usable, whatever the record holds."""

from __future__ import annotations

import pytest
from hostile_records import HOSTILE, spoilt_record
from report_pages import VIOLATING, record_with_trace
from session_records import session_record

from pytest_dura.reports.html.page import render

PHONE = {"viewport": {"width": 360, "height": 740}}
HOSTILE_TEXT = (
    "<script>window.hit = 1</script><img src=x onerror='window.hit = 1'>\"'><svg onload=hit=1>"
)


@pytest.fixture(scope="module")
def html(tmp_path_factory):
    return render(record_with_trace(tmp_path_factory.mktemp("bundle")))


def sideways(page):
    """By how many pixels the page is wider than the window."""
    return page.evaluate("document.documentElement.scrollWidth - innerWidth")


def rows(page):
    return [row.inner_text() for row in page.locator("tr.verdict").all() if row.is_visible()]


def test_the_gate_is_seen_first_and_stays_in_sight(opened, html):
    page = opened(html)
    word = page.locator("header .gate-word")
    assert word.inner_text() == "FAILED"
    assert page.title().startswith("failed: C")
    page.evaluate("scrollTo(0, document.body.scrollHeight)")
    assert word.bounding_box()["y"] < 50
    assert page.locator("h1").count() == 1


def test_each_table_has_a_caption_and_headings_with_a_scope(opened, html):
    page = opened(html)
    assert page.locator("table").count() > 12
    assert page.locator("table:not(:has(> caption))").count() == 0
    assert page.locator("th:not([scope])").count() == 0
    # What scrolls sideways can be reached with the keyboard, and says what it is.
    assert page.locator(".scroll:not([tabindex='0'])").count() == 0
    assert page.locator(".scroll:not([aria-label]):not([aria-labelledby])").count() == 0
    assert page.get_by_role("region", name="Verdicts by requirement").count() == 1


def test_the_filter_leaves_the_verdicts_that_fit(opened, html):
    page = opened(html)
    assert len(rows(page)) == 4
    page.get_by_label("Filter", exact=True).fill("ghost")
    assert page.locator("#filter-count").inner_text() == "2 of 4 verdicts"
    assert all("ghost" in row for row in rows(page))
    page.get_by_label("Verdict", exact=True).select_option("violated")
    assert [row.split()[0] for row in rows(page)] == ["a/clear+ghost"]
    page.get_by_label("Filter", exact=True).fill("Never collides")
    page.get_by_label("Verdict", exact=True).select_option("supported")
    assert [row.split()[0] for row in rows(page)] == ["a/clear"]
    page.get_by_label("Filter", exact=True).fill("")
    page.get_by_label("Verdict", exact=True).select_option("waived")
    assert "xfail: known" in rows(page)[0]
    assert page.locator("#verdicts tbody:visible").count() == 1


def test_without_scripts_everything_is_there_but_the_filter(opened, html):
    page = opened(html, java_script_enabled=False)
    assert len(rows(page)) == 4
    assert not page.locator("form.filter").is_visible()


def test_a_counterexample_opens_its_player(opened, html):
    page = opened(html)
    assert page.locator(".dura-player").count() == 0
    page.locator(".counterexamples a", has_text=VIOLATING).click()
    page.locator(".dura-player").wait_for()
    player = page.locator("details.player")
    assert player.get_attribute("open") is not None
    assert "SAF-1" in page.locator(".dura-verdicts").inner_text()
    # Closed by hand, the same link opens it again.
    player.locator("summary").first.click()
    assert player.get_attribute("open") is None
    page.locator("#forward a", has_text=VIOLATING).click()
    assert player.get_attribute("open") is not None


def test_an_address_with_a_player_opens_it(opened, html):
    page = opened(html)
    anchor = page.locator("details.player").get_attribute("id")
    page.evaluate("anchor => { location.hash = anchor }", anchor)
    page.locator(".dura-player").wait_for()


def test_a_verdict_that_the_filter_hides_is_shown_when_a_link_leads_to_it(opened, html):
    from playwright.sync_api import expect

    page = opened(html)
    page.get_by_label("Filter", exact=True).fill("nothing like it")
    assert rows(page) == []
    page.locator("#forward a", has_text="violated").first.click()
    # A browser tells the page of its new address after the click has returned.
    expect(page.locator("tr.verdict:visible")).to_have_count(4)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_is_wider_than_a_phone(opened, html, scheme):
    page = opened(html, **PHONE, color_scheme=scheme)
    assert sideways(page) <= 0
    page.locator(".counterexamples a", has_text=VIOLATING).click()
    page.locator(".dura-player").wait_for()
    assert sideways(page) <= 0


CONTRAST = """
() => {
  // The lowest contrast of any text against what is painted behind it (WCAG 2, relative luminance).
  const parse = (colour) => colour.match(/[\\d.]+/g).map(Number);
  const luminance = ([r, g, b]) => [r, g, b]
    .map((v) => v / 255).map((v) => v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
  const behind = (one) => {
    for (; one; one = one.parentElement) {
      const colour = parse(getComputedStyle(one).backgroundColor);
      if (colour.length === 3 || colour[3] > 0) return colour;
    }
    return [255, 255, 255];
  };
  let worst = [99, ""];
  for (const one of document.querySelectorAll("main *, header *, nav *")) {
    const own = [...one.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
    if (!own || !one.checkVisibility() || one.namespaceURI.endsWith("svg")) continue;
    const [a, b] = [luminance(parse(getComputedStyle(one).color)), luminance(behind(one))];
    const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (contrast < worst[0]) worst = [contrast, one.outerHTML.slice(0, 90)];
  }
  return worst;
}
"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_text_can_be_read_in_light_and_dark(opened, html, scheme):
    page = opened(html, color_scheme=scheme)
    ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
    red = int(ground.partition("(")[2].partition(",")[0])
    assert (red < 60) == (scheme == "dark")
    contrast, where = page.evaluate(CONTRAST)
    assert contrast >= 4.5, where


def test_it_prints_without_what_only_a_screen_can_do(opened, html):
    page = opened(html)
    page.emulate_media(media="print")
    assert not page.locator("nav").is_visible()
    assert not page.locator("form.filter").is_visible()
    assert page.locator("#verdicts").is_visible()
    # A4 across, 12 mm off on either side: nothing is cut off on paper.
    page.set_viewport_size({"width": 1032, "height": 700})
    for details in page.locator("details:not(.player)").all():
        details.evaluate("one => { one.open = true }")
    wide = "all => all.filter(one => one.scrollWidth > innerWidth).map(one => one.id)"
    assert page.locator("table").evaluate_all(wide) == []


def test_a_hostile_record_runs_nothing_and_loads_nothing(opened, tmp_path):
    spoil = "".join((HOSTILE_TEXT, *HOSTILE))
    record = spoilt_record(record_with_trace(tmp_path), lambda text: text + spoil, tmp_path)
    page = opened(render(record), **PHONE)
    for details in page.locator("details").all():
        details.evaluate("one => { one.open = true }")
    assert page.evaluate("window.hit") is None
    assert page.locator("main img, [onload], [onerror]").count() == 0
    assert "<script>window.hit" in page.locator("#verdicts").inner_text()
    assert sideways(page) <= 0


def test_injected_markup_would_not_run_even_if_it_were_not_escaped(opened):
    html = render(session_record()).replace("</h1>", f"</h1>{HOSTILE_TEXT}")
    opened.expected.append("Content Security Policy")
    page = opened(html)
    page.wait_for_timeout(100)
    assert page.locator("h1 + script").count() == 1
    assert page.evaluate("window.hit") is None
