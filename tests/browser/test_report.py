"""The report in a real browser: quiet, readable and usable, whatever the record holds."""

from __future__ import annotations

from contextlib import contextmanager

import pytest
from report_pages import VIOLATING, record_with_trace
from session_records import episode, session_record, verdict

from pytest_dura.reports import case_anchor, verdict_anchor
from pytest_dura.reports.html import page as report
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


def shown(page):
    """The names of the views that are in sight."""
    return [view.get_attribute("id") for view in page.locator(".view:visible").all()]


@contextmanager
def moves(page):
    """Waits until the page has acted on the new address: the browser tells it later."""
    page.evaluate("""() => {
        const { dataset } = document.documentElement;
        delete dataset.moved;
        addEventListener("hashchange", () => { dataset.moved = "" }, { once: true });
    }""")
    yield
    page.locator("html[data-moved]").wait_for()


def go(page, anchor):
    """Leads the page to another address than its present one."""
    with moves(page):
        page.evaluate("anchor => { location.hash = anchor }", anchor)


def follow(page, link):
    """Clicks a link to another address than the present one."""
    with moves(page):
        link.click()


def go_back(page):
    with moves(page):
        page.go_back()


def test_the_gate_is_seen_first_and_stays_in_sight(opened, html):
    page = opened(html)
    word = page.locator("header .gate-word")
    assert word.inner_text() == "FAILED"
    assert page.title().startswith("failed: C")
    page.evaluate("scrollTo(0, document.body.scrollHeight)")
    assert word.bounding_box()["y"] < 50
    assert page.locator("h1").count() == 1
    assert shown(page) == ["overview"]


def test_each_table_has_a_caption_and_headings_with_a_scope(opened, html):
    page = opened(html)
    assert page.locator("table").count() > 12
    assert page.locator("table:not(:has(> caption))").count() == 0
    assert page.locator("th:not([scope])").count() == 0
    # What scrolls sideways can be reached with the keyboard, and says what it is.
    assert page.locator(".scroll:not([tabindex='0'])").count() == 0
    assert page.locator(".scroll:not([aria-label]):not([aria-labelledby])").count() == 0


def test_a_link_of_the_navigation_shows_its_view_alone_and_back_and_forward_work(opened, html):
    page = opened(html)
    names = [link.get_attribute("href")[1:] for link in page.locator("nav a").all()]
    assert {"overview", "requirements", "cases", "episodes", "matrix", "files"} <= set(names)
    for name in names:
        follow(page, page.locator(f"nav a[href='#{name}']"))
        assert shown(page) == [name]
        assert page.locator("nav a[aria-current]").get_attribute("href") == f"#{name}"
    go_back(page)
    assert shown(page) == [names[-2]]
    with moves(page):
        page.go_forward()
    assert shown(page) == [names[-1]]


def test_one_requirement_is_seen_at_a_time_and_the_way_back_leads_to_it(opened, html):
    page = opened(html)
    follow(page, page.locator("nav a", has_text="Requirements"))
    entries = page.locator("#verdicts > tbody.entry:visible")
    assert entries.count() == 3
    assert rows(page) == []
    follow(page, page.get_by_role("link", name="SAF-1", exact=True))
    assert entries.count() == 1
    assert len(rows(page)) == 2
    assert page.evaluate("location.hash") == "#requirement-SAF-1"
    go_back(page)
    assert (entries.count(), rows(page)) == (3, [])
    assert page.evaluate("document.activeElement.hash") == "#requirement-SAF-1"


def test_the_filter_leaves_what_fits_in_the_list_and_in_an_entry(opened, html):
    page = opened(html)
    follow(page, page.locator("nav a", has_text="Requirements"))
    form = page.get_by_role("search", name="Filter the verdicts")
    count, entries = form.locator("output"), page.locator("#verdicts > tbody.entry:visible")
    form.get_by_label("Filter").fill("ghost")
    assert count.inner_text() == "2 of 4 verdicts"
    form.get_by_label("Verdict").select_option("violated")
    assert entries.count() == 1
    assert "1 of 2 fit" in entries.inner_text()
    follow(page, page.get_by_role("link", name="SAF-1", exact=True))
    assert [row.split()[0] for row in rows(page)] == ["a/clear+ghost"]
    form.get_by_label("Filter").fill("Never collides")
    form.get_by_label("Verdict").select_option("supported")
    assert [row.split()[0] for row in rows(page)] == ["a/clear"]
    page.keyboard.press("Escape")  # empties the field
    page.keyboard.press("Escape")
    page.locator("#verdicts:not(.opened)").wait_for()
    form.get_by_label("Filter").fill("")
    form.get_by_label("Verdict").select_option("")
    form.get_by_label("Kind").select_option("performance")
    assert [entry.split()[0] for entry in entries.all_inner_texts()] == ["PERF-1"]
    form.get_by_label("Kind").select_option("")
    form.get_by_label("Verdict").select_option("waived")
    assert count.inner_text() == "1 of 4 verdicts"


def test_episodes_are_filtered_by_validity_and_by_what_they_violate(opened, html):
    page = opened(html)
    follow(page, page.locator("nav a", has_text="Episodes"))
    form = page.get_by_role("search", name="Filter the episodes")
    entries = page.locator("#episode-list > tbody.entry:visible")
    form.get_by_label("Validity").select_option("missing")
    assert entries.count() == 1
    form.get_by_label("Validity").select_option("")
    form.get_by_label("Violates").select_option("SAF-1")
    assert [entry.split()[1] for entry in entries.all_inner_texts()] == [VIOLATING]


def many_verdicts(count):
    """The record of the support module with so many cases that violate SAF-1."""
    record = session_record()
    case = record.head.cases[0]
    names = [f"a/case{number}" for number in range(count)]
    return session_record(
        cases=[case.replace(id=name) for name in names],
        verdicts=[verdict("SAF-1", name, ("violated",)) for name in names],
        episodes=[episode(name, 0, seed=place) for place, name in enumerate(names)],
    )


def test_of_a_long_list_a_page_is_drawn_and_a_link_finds_its_own(opened):
    page = opened(render(many_verdicts(120)))
    go(page, "cases")
    entries = page.locator("#outcomes > tbody.entry:visible")
    pager = page.locator("#cases .pager").first
    assert entries.count() == 50
    assert "1 to 50 of 120" in pager.inner_text()
    pager.get_by_role("button", name="Next").click()
    pager.get_by_role("button", name="Next").click()
    assert "101 to 120 of 120" in pager.inner_text()
    assert entries.count() == 20
    anchor = verdict_anchor("SAF-1", "a/case77")
    go(page, anchor)
    assert page.locator(f"#{anchor}").is_visible()
    assert len(rows(page)) == 50
    assert page.evaluate("document.documentElement.scrollHeight") > 900
    go(page, "overview")
    assert page.evaluate("document.documentElement.scrollHeight") <= 6 * 900


def test_a_packed_row_is_unpacked_where_its_view_or_a_link_asks_for_it(opened, monkeypatch):
    monkeypatch.setattr(report, "MAX_PLAIN_ROWS", 50)
    monkeypatch.setattr(report, "KEPT_ROWS", 10)
    html = render(many_verdicts(120))
    page = opened(html)
    anchor = verdict_anchor("SAF-1", "a/case77")
    assert page.locator(f"#{anchor}").count() == 0
    go(page, anchor)
    page.locator(f"#{anchor}").wait_for()
    count = page.get_by_role("search", name="Filter the verdicts").locator("output")
    assert count.inner_text() == "120 of 120 verdicts"
    go(page, "cases")
    assert "1 to 50 of 120" in page.locator("#cases .pager").first.inner_text()
    plain = opened(html, java_script_enabled=False)
    assert plain.get_by_text("Most rows are packed, and need JavaScript").first.is_visible()


def test_without_scripts_everything_is_there_but_the_filter(opened, html):
    page = opened(html, java_script_enabled=False)
    assert len(rows(page)) == 4
    assert not page.locator("form.filter").first.is_visible()
    assert shown(page)[:3] == ["overview", "requirements", "cases"]
    assert page.locator("article.card").first.is_visible()


def test_from_opening_the_page_to_the_frame_of_the_violation_it_is_one_click(opened, html):
    page = opened(html)
    assert page.locator(".card .picture svg").first.is_visible()
    assert page.locator(".dura-player").count() == 0
    follow(page, page.get_by_role("link", name="▶ Play it").first)
    page.locator(".dura-player").wait_for()
    assert shown(page) == ["episodes"]
    assert page.locator("details.player").get_attribute("open") is not None
    assert "SAF-1" in page.locator(".dura-player").inner_text()
    page.locator(".dura-player:focus").wait_for()
    page.keyboard.press("v")  # the second step on the way to the frame of the violation
    assert "at the violation of SAF-1" in page.locator(".dura-clock").inner_text()
    # The episode itself is open above it.
    assert page.locator("#episode-list > tbody.entry:visible").count() == 1


def test_a_counterexample_opens_its_player_again_and_again(opened, html):
    page = opened(html)
    go(page, "requirement-SAF-1")
    follow(page, page.locator(".counterexamples a:visible", has_text=VIOLATING))
    player = page.locator("details.player")
    assert player.get_attribute("open") is not None
    player.locator("summary").first.click()
    assert player.get_attribute("open") is None
    go_back(page)
    follow(page, page.locator(".counterexamples a:visible", has_text=VIOLATING))
    assert player.get_attribute("open") is not None


def test_an_address_with_a_player_opens_it(opened, html):
    page = opened(html)
    anchor = page.locator("details.player").get_attribute("id")
    go(page, anchor)
    page.locator(".dura-player").wait_for()


def test_a_verdict_that_the_filter_hides_is_shown_when_a_link_leads_to_it(opened, html):
    page = opened(html)
    go(page, "requirements")
    page.get_by_label("Filter", exact=True).first.fill("nothing like it")
    assert page.locator("#verdicts > tbody.entry:visible").count() == 0
    go(page, "matrix")
    follow(page, page.locator("#matrix-2 a.plain", has_text="violated").first)
    assert len(rows(page)) == 1
    assert page.get_by_label("Filter", exact=True).first.input_value() == ""


def test_everything_is_reached_by_keys_alone(opened, html):
    page = opened(html)
    page.locator("nav a", has_text="Requirements").focus()
    page.keyboard.press("Enter")
    page.locator("#requirements").wait_for()
    page.keyboard.press("j")
    page.keyboard.press("j")
    focused = "document.activeElement.textContent"
    assert page.evaluate(focused) == "PERF-1"
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    page.keyboard.press("k")
    assert page.evaluate(focused) == "SAF-1"
    page.keyboard.press("Enter")
    page.wait_for_url("**#requirement-SAF-1")
    page.locator("#verdicts:not(.opened)").wait_for(state="hidden")
    page.keyboard.press("j")
    page.wait_for_url("**#requirement-PERF-1")
    page.keyboard.press("Escape")
    page.wait_for_url("**#requirements")
    page.keyboard.press("/")
    page.keyboard.type("jk/")
    assert page.get_by_label("Filter", exact=True).first.input_value() == "jk/"


def test_a_slash_leads_from_an_entry_to_the_filter(opened, html):
    page = opened(html)
    go(page, "requirement-SAF-1")
    page.locator("#verdicts:not(.opened)").wait_for(state="hidden")
    page.keyboard.press("/")
    page.locator("#verdicts:not(.opened)").wait_for()
    page.keyboard.type("PERF")
    assert page.get_by_label("Filter", exact=True).first.input_value() == "PERF"


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_in_any_view(opened, axe, html, scheme):
    page = opened(html, color_scheme=scheme)
    player = page.locator("details.player").get_attribute("id")
    names = [link.get_attribute("href")[1:] for link in page.locator("nav a").all()]
    problems = {}
    for name in [*names, "requirement-SAF-1", case_anchor("a/clear"), player]:
        go(page, name)
        for found in axe.run(page).response["violations"]:
            # A player has its own tests.
            nodes = [node["html"][:200] for node in found["nodes"]]
            problems.setdefault(found["id"], []).append((name, nodes[:3]))
    assert problems == {}


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_is_wider_than_a_phone(opened, html, scheme):
    page = opened(html, **PHONE, color_scheme=scheme)
    names = [link.get_attribute("href")[1:] for link in page.locator("nav a").all()]
    for name in [*names, "requirement-SAF-1", case_anchor("a/clear")]:
        go(page, name)
        assert sideways(page) <= 0, name
    go(page, "overview")
    follow(page, page.get_by_role("link", name="▶ Play it").first)
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
    for name in [link.get_attribute("href") for link in page.locator("nav a").all()]:
        go(page, name)
        contrast, where = page.evaluate(CONTRAST)
        assert contrast >= 4.5, (name, where)


def test_it_prints_without_what_only_a_screen_can_do(opened, html):
    page = opened(html)
    page.emulate_media(media="print")
    assert not page.locator("nav").is_visible()
    assert not page.locator("form.filter:visible").count()
    assert shown(page) == ["overview", "requirements", "plots", "tables"]
    assert len(rows(page)) == 4
    # A4 across, 12 mm off on either side: nothing is cut off on paper.
    page.set_viewport_size({"width": 1032, "height": 700})
    for details in page.locator("details:not(.player)").all():
        details.evaluate("one => { one.open = true }")
    wide = "all => all.filter(one => one.scrollWidth > innerWidth).map(one => one.id)"
    assert page.locator("table").evaluate_all(wide) == []


def test_injected_markup_would_not_run_even_if_it_were_not_escaped(opened):
    html = render(session_record()).replace("</h1>", f"</h1>{HOSTILE_TEXT}")
    opened.expected.append("Content Security Policy")
    page = opened(html)
    page.wait_for_timeout(100)
    assert page.locator("h1 + script").count() == 1
    assert page.evaluate("window.hit") is None
