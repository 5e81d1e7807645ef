"""Laws of the texts that evidence shows, whatever users and components wrote."""

import ast
import re
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from jinja2 import Environment

import pytest_dura
from pytest_dura.evidence import code, markdown, name, one_line, visible
from pytest_dura.evidence.text import LEAST_LIMIT, without_commands
from pytest_dura.reports.svg import NAMESPACE, document, joined, tag

HOSTILE = (
    "\x00\x1b[31m", "\x7f\x9b", "\u202e\u2066\u200b\u2060\ufeff", "\ud800", "\udfff",
    "\u2028\u2029",
    "\ufffe\uffff", "\U0001fffe", "\u3164\u115f\u034f", "\r\n\r\t ", "\xa0\u3000", "]](http://x)",
    "|", "\\|", "\\", "`", "``", "@me", "#1", "www.x.org", "<script>", "&lt;", "$x$", "- ", "1. ",
    "\U000e0041", "\u0644\u0627", "é\U0001f600",
)  # fmt: skip
TEXTS = st.one_of(
    st.text(st.characters(codec=None)),
    st.lists(st.sampled_from(HOSTILE) | st.text(max_size=3), max_size=30).map("".join),
    st.builds(str.__mul__, st.sampled_from(HOSTILE), st.integers(0, 400)),
)
LIMITS = st.integers(LEAST_LIMIT, 200)
quick = settings(derandomize=True, deadline=None, max_examples=100)


def is_harmless(text):
    """Printable, legal in XML 1.0, and possible to encode."""
    assert text.isprintable()
    root = ET.Element("x")
    root.text = text
    again = ET.fromstring(ET.tostring(root, encoding="utf-8"))
    return (again.text or "") == text and text.encode("utf-8")


@quick
@given(TEXTS, LIMITS, st.booleans())
@example("x" * 65, 64, False)
@example("\r\n" * 65, 64, False)
@example("\x1b" * 16, 64, False)
def test_visible_text_is_harmless_bounded_and_stays_as_it_is(text, limit, hashed):
    shown = visible(text, limit, hashed=hashed)
    assert len(shown) <= limit
    assert is_harmless(shown.replace("\n", "").replace("\t", "")) or not shown.strip("\n\t")
    assert visible(shown, limit, hashed=hashed) == shown


COMMANDS = st.lists(
    st.sampled_from(
        ("::error::x", "::", ":", "##[error]", "##vso[x]", "##TeamCity[x]", "##", "[", "\n", "\r",
         "\x0b", "\x85", "\u2028", " ", "\t", "\xa0", "\\", "x")
    ),
    max_size=12,
).map("".join)  # fmt: skip


@quick
@given(COMMANDS | TEXTS)
def test_no_line_is_a_command_of_a_ci(text):
    before = visible(text)
    shown = without_commands(before)
    assert not [line for line in shown.splitlines() if line.strip().startswith("::")]
    assert not re.search(r"##\w*\[", shown)
    assert without_commands(shown) == shown
    pairs = zip(shown, before, strict=True)
    assert {pair for pair in pairs if pair[0] != pair[1]} <= {("\\", ":"), ("\\", "#")}


@quick
@given(TEXTS, LIMITS)
def test_one_line_is_one_line(text, limit):
    shown = one_line(text, limit)
    assert len(shown) <= limit
    assert is_harmless(shown) or not shown
    assert shown.splitlines() in ([], [shown])
    assert "  " not in shown
    assert one_line(shown, limit) == shown


@quick
@given(TEXTS, TEXTS, LIMITS)
@example("a\nb", "a b", 64)
@example("a\u200bb", "ab", 64)
@example("x" * 65 + "1", "x" * 65 + "2", 64)
def test_names_that_differ_stay_different(one, other, limit):
    shown = [name(one, limit), name(other, limit)]
    assert all(len(text) <= limit and text.isprintable() for text in shown)
    assert (shown[0] == shown[1]) == (one == other)
    assert [name(text, limit) for text in shown] == shown


@pytest.mark.parametrize(
    "text, shown",
    [
        ("a\x00b\x1b[31m", "a\\x00b\\x1b[31m"),
        ("a\u202eb\ud800\ufffe\U000e0041", "a\\u202eb\\ud800\\ufffe\\U000e0041"),
        ("a\u3164\u2028\x85", "a\\u3164\\u2028\\x85"),
        ("10\xa0s\r\nnext\ttab", "10 s\nnext\ttab"),
        ("a\rb", "a\\rb"),
        ("naïve 漢字 😀", "naïve 漢字 😀"),
    ],
)
def test_what_is_hidden_is_written_as_an_escape(text, shown):
    assert visible(text) == shown


def test_a_shortened_text_says_how_long_it_was():
    text = "x" * 2**20
    assert visible(text, 64) == "x" * 40 + "... (1048576 characters)"
    assert one_line(text, 64).endswith("... (1048576 characters)")
    assert re.fullmatch(r"x+\.\.\. \(1048576 characters, #[0-9a-f]{8}\)", name(text))


def test_an_escape_is_never_cut():
    assert visible("a" * 41 + "\u202e" * 30, 64) == "a" * 41 + "... (71 characters)"


def test_a_limit_without_room_for_the_note_is_an_error():
    with pytest.raises(ValueError, match="below 64"):
        visible("x", 63)


def test_lines_and_blanks_become_one_space_but_in_names():
    assert one_line(" a \r\n\t b\xa0") == "a b"
    assert name("a\nb").startswith("a\\nb (#")
    assert name("a\xa0b").startswith("a\\xa0b (#")
    assert name("SAF-1") == "SAF-1"


@pytest.mark.parametrize(
    "text, shown",
    [
        ("a|b", "`a\\|b`"),
        ("a\\|b", "`a\\\\x7cb`"),
        ("a`b", "``a`b``"),
        ("`", "`` ` ``"),
        ("$x$", "` $x$ `"),
        ("", ""),
        ("\n", ""),
    ],
)
def test_code_spans(text, shown):
    assert code(text) == shown


@pytest.mark.parametrize(
    "text, shown",
    [
        ("plain, with (brackets) - and 3.5 m/s", "plain, with (brackets) - and 3.5 m/s"),
        ("a|b <i> [x](y) *z*", r"a\|b \<i\> \[x\](y) \*z\*"),
        ("# no heading", r"\# no heading"),
        ("1. no list", r"1\. no list"),
        ("- no list", r"\- no list"),
        ("ask @me", "`ask @me`"),
        ("see http://x", "`see http://x`"),
        ("like #12", "`like #12`"),
        ("c0ffee1 broke it", "`c0ffee1 broke it`"),
        ("a\nb", "a b"),
    ],
)
def test_prose_in_markdown(text, shown):
    assert markdown(text) == shown


PACKAGE = Path(pytest_dura.__file__).parent
TEMPLATE = Environment(autoescape=True).from_string("<p>{{ element }}{{ text }}</p>")
CONSTANTS = {"reports/html/player.py", "reports/gsn/drawing.py"}
"""Modules with markup in a constant: the page of a player, and the ends of arrows."""


@quick
@given(TEXTS)
@example("</text><script>alert('1')</script> & ' \" --> ]]>")
def test_an_element_holds_texts_as_texts_and_elements_as_elements(text):
    """What a browser and a reader of XML get of any text of a picture, or of a page's template."""
    shown = one_line(text)
    inner = tag("title", shown)
    root = ET.fromstring(document(10, 20, tag("g", inner, shown, class_=shown, data_id=shown)))
    (group,) = root
    assert [one.tag.removeprefix(f"{{{NAMESPACE}}}") for one in root.iter()] == [
        "svg",
        "g",
        "title",
    ]
    assert group.get("class") == group.get("data-id") == shown
    assert (group[0].text or "") == (group[0].tail or "") == shown
    assert joined([shown, inner], "\n").endswith(f"\n{inner}")
    paragraph = ET.fromstring(TEMPLATE.render(element=inner, text=shown))
    assert [one.tag for one in paragraph.iter()] == ["p", "title"]
    assert "".join(paragraph.itertext()) == shown * 2
    # Sums of elements are texts again, and are escaped.
    assert list(ET.fromstring(tag("g", inner + inner))) == []


def test_nothing_else_makes_markup():
    """So that a picture and a page have no other way to show a text than the law above."""
    writers, trusted = set(), []
    for file in PACKAGE.rglob("*.py"):
        where = file.relative_to(PACKAGE).as_posix()
        nodes = list(ast.walk(ast.parse(file.read_text("utf-8"))))
        prose = {node.value for node in nodes if isinstance(node, ast.Expr)}
        for node in {*nodes} - prose:
            if isinstance(node, ast.Constant) and where.startswith("reports/"):
                writers |= {where} if re.search("<[a-z]", str(node.value)) else set()
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Markup":
                trusted.append(where)
    assert writers == CONSTANTS
    assert sorted(trusted) == ["reports/html/page.py", "reports/html/players.py"]
    templates = "".join(file.read_text("utf-8") for file in PACKAGE.rglob("templates/*.html"))
    assert set(re.findall(r"(\S+) ?\| ?safe", templates)) <= {'"<br>"', '{{"<br>"'}
