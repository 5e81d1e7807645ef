"""Hostile texts in every place of a session at once: the whole bundle is harmless, and intact."""

from __future__ import annotations

import base64
import io
import json
import re
import zlib
from collections import Counter
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from xml.etree import ElementTree as ET

import jsonschema
import pytest
import yaml
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
from google.protobuf import json_format
from gsn_rules import rule_problems
from hostile_bundles import MEGABYTE, SORTS, Spoiler, real_session, session, spoilers
from hypothesis import given, settings
from in_toto_attestation.predicates.test_result.v0 import test_result_pb2
from in_toto_attestation.v1 import statement_pb2
from in_toto_attestation.v1.statement import Statement
from markdown_it import MarkdownIt
from mcap.reader import NonSeekingReader

from pytest_dura.__main__ import main
from pytest_dura.evidence import (
    all_formats,
    read_trace,
    record_schema,
    verify_bundle,
    write_bundle,
)
from pytest_dura.evidence.bundle import FORMATS, default_files
from pytest_dura.plugin.options import Options
from pytest_dura.plugin.session.terminal import summary
from pytest_dura.reports.cards import cards_of

# What a terminal, an editor or a reader might act on instead of showing it.
CONTROL = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
    "\ufffe\uffff\ud800-\udfff\U000e0000-\U000e007f]"
)
COMMAND = re.compile(r"^\s*::|##\w*\[", re.MULTILINE)
"""What a CI takes for a command in its log."""
JSON = ("evidence.json", "cyclonedx.json", "test-result.intoto.json", "manifest.json")
LARGEST = 400_000
"""Bytes of a file that is rendered, however long the texts of the record are."""


class Bundle:
    """A bundle in a folder of its own, beside which nothing else may come to lie."""

    def __init__(self, real, root, spoil):
        self.directory = root / "bundle"
        self.directory.mkdir()
        exports = [name for name in FORMATS if name not in default_files()]
        self.record = write_bundle(session(real, self.directory, spoil), exports)
        self.root, self.real = root, real

    def text(self, name):
        return (self.directory / name).read_bytes().decode()

    def json(self, name):
        return json.loads(self.text(name), parse_constant=pytest.fail)

    @property
    def files(self):
        found = (path for path in self.root.rglob("*") if not path.is_dir() or path.is_symlink())
        return sorted(path.relative_to(self.root).as_posix() for path in found)

    @property
    def traces(self):
        return [one.trace.file for one in self.record.episodes() if one.trace]


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    """The bundle of a session whose texts hide nothing."""
    return real_session(tmp_path_factory.mktemp("real") / "project")


@cache
def harmless(real):
    """The page and the picture of the same session whose texts hide nothing."""
    with TemporaryDirectory() as folder:
        bundle = Bundle(real, Path(folder), Spoiler([]))
        assert verify_bundle(bundle.directory).problems == []
        return {name: bundle.text(name) for name in ("report.html", "assurance-case.svg")}


@settings(derandomize=True, deadline=None, max_examples=3)
@given(spoil=spoilers())
def test_a_session_full_of_hostile_texts_leaves_a_harmless_bundle(real, spoil):
    with TemporaryDirectory() as folder:
        bundle = Bundle(real, Path(folder), spoil)
        assert max(map(len, spoil.given.values())) > MEGABYTE
        assert bundle.record.head.gate.reasons[-1] == spoil("another one")  # no format failed
        found = verify_bundle(bundle.directory)
        assert found.problems == []
        assert len(found.rejudged) > 3
        check_files(bundle)
        check_record(bundle, spoil)
        check_report(bundle)
        check_assurance_case(bundle)
        check_summary(bundle)
        check_declarations(bundle)
        check_statement(bundle)
        check_terminal(bundle)
        for name in bundle.traces:
            check_trace(bundle.directory / name)


def check_files(bundle):
    """Nothing outside of the bundle; harmless names; texts without controls; bounded sizes."""
    rendered = [one.FILE for one in all_formats()]
    known = {*JSON, *rendered, *bundle.traces}
    assert bundle.files == sorted(f"bundle/{name}" for name in known)
    for name in known:
        assert re.fullmatch(r"(episodes/)?[A-Za-z0-9_][A-Za-z0-9._-]*", name)
        assert ".." not in name
        assert len(name) < 120
        if not name.endswith(".mcap"):
            assert CONTROL.findall(bundle.text(name)) == []
    for name in {*known} - {"evidence.json", *bundle.traces}:
        assert (bundle.directory / name).stat().st_size < LARGEST


def check_record(bundle, spoil):
    """It holds every text as it was, and is what its published schema describes."""
    record = bundle.json("evidence.json")
    jsonschema.Draft202012Validator(record_schema()).validate(record)
    held = set(strings(record))
    assert held >= {
        spoil(name) for name in ("GAP-1", "corridor/free+none", "known since long", "inner value")
    }


def strings(value):
    """All texts of plain data, keys as well."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for name, one in value.items():
            yield name
            yield from strings(one)
    elif isinstance(value, list):
        for one in value:
            yield from strings(one)


def is_visible(value):
    return CONTROL.search("\n".join(strings(value))) is None


class Markup(HTMLParser):
    """Each element with the names of its attributes, and what could run, load or lead away."""

    def __init__(self, html):
        super().__init__(convert_charrefs=True)
        self.elements, self.leads, self.policies, self.data, self.open = Counter(), [], [], [], ""
        self.feed(html)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.open = dict(attrs).get("type", tag)
        names = [name for name, _ in attrs]
        assert len(set(names)) == len(names)
        assert not [name for name in names if name.startswith("on")]
        self.elements[tag, tuple(sorted(names))] += 1
        for name, value in attrs:
            if name in ("href", "src", "srcset", "action", "formaction", "style", "xlink:href"):
                self.leads.append(value)
            if name == "content" and "default-src" in value:
                self.policies.append(value)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)

    def handle_data(self, data):
        if self.open == "application/octet-stream" and data.strip():
            self.data.append(data)

    def handle_endtag(self, tag):
        self.open = ""

    def handle_comment(self, data):
        pytest.fail(f"a comment: {data[:80]!r}")

    def handle_pi(self, data):
        pytest.fail(f"an instruction: {data[:80]!r}")

    def unknown_decl(self, data):
        pytest.fail(f"a declaration: {data[:80]!r}")


EMPTY_CELL = re.compile('<span class="none(?: nil)?">[0\u2013]</span>')
"""What a cell shows of nothing: of hostile choices, none was drawn."""


def check_report(bundle):
    """The very elements and attributes of the harmless page, and nothing that leads out of it."""
    page, expected = (
        Markup(EMPTY_CELL.sub("", bundle.text("report.html"))),
        Markup(EMPTY_CELL.sub("", harmless(bundle.real)["report.html"])),
    )
    assert without_marks(page.elements) == without_marks(expected.elements)
    out = [one for one in page.leads if not re.fullmatch(r"#[A-Za-z0-9._-]+", one)]
    assert {f"bundle/{one.removeprefix('./')}" for one in out} <= {*bundle.files}
    assert page.policies == expected.policies
    assert len(page.policies) == 1
    assert re.match("default-src 'none'; script-src( 'sha256-[^' ]+')+; ", page.policies[0])
    assert "unsafe" not in page.policies[0]
    assert len(page.data) == len(bundle.traces)
    for packed in page.data:
        played = json.loads(zlib.decompress(base64.b64decode(packed, validate=True)))
        assert is_visible(played)


def without_marks(elements):
    """Counts of elements; cells of maps of draws hold a number or a stroke.

    Names may break behind their separators, and what stands between backticks is code: both
    elements have no attributes, and depend on a text's length alone.
    Drawn choices are not among the hostile ones of the variation: their cells are struck out.
    """
    marks = ("text", ("class", "text-anchor", "x", "y")), ("polyline", ("class", "points"))
    in_texts = ("wbr", ()), ("code", ())
    plain = {kind: count for kind, count in elements.items() if kind not in (*marks, *in_texts)}
    return plain | {"marks": sum(elements[mark] for mark in marks)}


def check_assurance_case(bundle):
    elements = yaml.safe_load(bundle.text("assurance-case.gsn.yaml"))
    assert is_visible(elements)
    del elements["module"]
    assert rule_problems(elements) == []
    svg = bundle.text("assurance-case.svg")
    assert "<!" not in svg
    assert "<?" not in svg.removeprefix("<?xml")
    kinds = {(one.tag, name) for one in ET.fromstring(svg).iter() for name in ("", *one.attrib)}
    known = ET.fromstring(harmless(bundle.real)["assurance-case.svg"])
    assert kinds <= {(one.tag, name) for one in known.iter() for name in ("", *one.attrib)}
    assert not [name for _, name in kinds if name.startswith("on") or "href" in name]


def check_summary(bundle):
    text = bundle.text("summary.md")
    parsed = MarkdownIt("gfm-like", {"linkify": False, "html": True}).parse(text)
    tokens = [token for one in parsed for token in (one, *(one.children or ()))]
    kinds = {token.type for token in tokens}
    assert not kinds & {"html_block", "html_inline", "link_open", "image", "fence", "code_block"}
    prose = "".join(token.content for token in tokens if token.type == "text")
    assert not re.search(r"@|://|www\.|#\d|\$", prose)  # what GitHub links although it is escaped
    cards = len(re.findall(r"^## `*Cause \d+, ", text, re.MULTILINE))
    assert 0 < cards <= len(cards_of(bundle.record))
    assert sum(token.type == "heading_open" for token in tokens) == 6 + cards
    head = bundle.record.head
    held = (head.verdicts, head.requirements, head.cases, head.hazards)
    assert sum(token.type == "tr_open" for token in tokens) == 7 + sum(map(len, held))


@cache
def strict():
    return JsonStrictValidator(SchemaVersion.V1_6)


def check_declarations(bundle):
    assert strict().validate_str(bundle.text("cyclonedx.json")) is None
    assert is_visible(bundle.json("cyclonedx.json"))


def check_statement(bundle):
    text = bundle.text("test-result.intoto.json")
    message = json_format.Parse(text, statement_pb2.Statement())
    Statement.copy_from_pb(message).validate()
    result = json_format.ParseDict(json.loads(text)["predicate"], test_result_pb2.TestResult())
    told = [*result.passed_tests, *result.warned_tests, *result.failed_tests]
    assert len(set(told)) == len(bundle.record.head.verdicts)
    assert result.result == "FAILED"
    assert is_visible(json.loads(text))


@cache
def validator(schema):
    return jsonschema.Draft202012Validator(json.loads(schema))


def check_trace(file):
    """Messages and metadata that a viewer shows are harmless; the columns are exact."""
    trace = read_trace(file)
    reader = NonSeekingReader(io.BytesIO(file.read_bytes()), validate_crcs=True)
    topics = set()
    for schema, channel, message in reader.iter_messages():
        told = json.loads(message.data, parse_constant=pytest.fail)
        validator(schema.data).validate(told)
        assert is_visible(told)
        assert len(message.data) < 50_000
        topics.add(channel.topic)
    assert topics >= {"/signals", "/events"}
    reader = NonSeekingReader(io.BytesIO(file.read_bytes()))
    metadata = {one.name: one.metadata for one in reader.iter_metadata()}
    assert metadata.keys() == {"trace", "about", "verdicts"}
    assert is_visible(metadata)
    assert is_visible([json.loads(one) for one in metadata["about"].values()])
    assert sum(map(len, strings(metadata))) < 50_000
    assert trace.about["id"].endswith(("#0", "#1"))


class Terminal:
    """What is written to pytest's terminal."""

    def __init__(self):
        self.text = ""

    def write(self, text, **_):
        self.text += text

    def line(self, text, **_):
        self.text += f"{text}\n"

    def section(self, title, _):
        self.text += f"= {title} =\n"


def check_terminal(bundle):
    """Nothing acts on a terminal, or reads as another line of ours."""
    config = SimpleNamespace(
        args_source=None, ArgsSource=SimpleNamespace(ARGS=1),
        option=SimpleNamespace(inifilename=None, rootdir=None, verbose=0),
        invocation_params=SimpleNamespace(dir=bundle.root), rootpath=bundle.root,
        getoption=lambda *_: None, getini=lambda _: None,
    )  # fmt: skip
    session = SimpleNamespace(
        config=config, active=True, options=Options(config),
        guests=SimpleNamespace(in_replay=dict),
    )  # fmt: skip
    terminal = Terminal()
    summary(
        session, terminal, bundle.record, file=bundle.directory / "evidence.json", notes=[],
        objections=bundle.record.head.gate.reasons, shared=SimpleNamespace(is_whole=True),
    )  # fmt: skip
    assert CONTROL.findall(terminal.text) == []
    assert COMMAND.findall(terminal.text) == []
    assert len(terminal.text) < LARGEST
    ours = [line for line in terminal.text.split("\n") if line.startswith(("gate:", "#", "|"))]
    assert [line[:13] for line in ours] == ["gate: failed,"]


def test_what_a_verifier_tells_of_hostile_texts_is_harmless(real, tmp_path, capsys):
    text = "".join(one for sort in SORTS for one in sort)
    bundle = Bundle(real, tmp_path, Spoiler([text]))
    file = bundle.directory / "evidence.json"
    told = json.loads(file.read_text())
    told["verdicts"][0]["case"] = told["episodes"][0]["case"] = told["cases"][0]["id"] + text
    told["requirements"][0][text] = text * 99
    file.write_text(json.dumps(told))
    assert main(["verify", str(bundle.directory)]) == 1
    del told["requirements"][0][text]
    file.write_text(json.dumps(told))
    assert main(["verify", str(bundle.directory)]) == 1
    shown = capsys.readouterr().out
    assert CONTROL.findall(shown) == []
    assert COMMAND.findall(shown) == []
    assert len(shown.splitlines()) > 10
    assert max(map(len, shown.splitlines())) <= 2000
