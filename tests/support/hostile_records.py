"""Session records whose every free text is hostile, for those who render records."""

from pathlib import Path

from hypothesis import strategies as st
from searches import entry
from session_records import REQUIREMENTS, hazard, session_record, totals, verdict

from pytest_dura.core.codec import decode, encode
from pytest_dura.core.mismatches import MismatchError
from pytest_dura.evidence import SessionRecord
from pytest_dura.evidence.model import WholeRecord

HOSTILE = (
    "\x00", "\x1b[31m", "\x7f\x9b", "\u202e", "\u2066\u200b\ufeff", "\ud800", "\udfff", "\u2028",
    "\ufffe\uffff", "\u3164", "\r\n", "\r", "\t", "\n\n# Gate passed\n", "\n## Cases\n",
    "\n| a |\n",
    "|", "\\|", "\\", "`", "``", "](http://evil.example)", "[x](javascript:alert(1))",
    "http://evil.example", "www.evil.example", "a@evil.example", "@me", "#1", "GH-1",
    "<script>alert(1)</script>", "</script>", "<!--", "-->", "&lt;", "]]>", "'", '"', "$x$",
    "$(x)", "../../etc/passwd", "/", "..", "%2e", "{{x}}", "{%", "- ", "1. ", "---",
    "urn:cdx:x", "::",
    "é😀",
)  # fmt: skip
SMALL = st.lists(st.sampled_from(HOSTILE), max_size=4).map("".join)
SIZES = st.sampled_from([0] * 9 + [2**17])

_FREE = {
    "id", "text", "kind", "source", "check", "reason", "case", "requirement", "component", "name",
    "path", "item", "scenario", "failure", "invalid_reason", "command", "detail", "subject",
    "episode", "version", "python", "platform", "commit", "faults", "reasons", "requirements",
    "packages", "file", "mitigates", "loss", "operating_condition", "triggering_condition",
}  # fmt: skip


def spoilt(value, spoil, *, key=""):
    """The record with each free text, also of keys of ``packages``, passed through ``spoil``."""
    if isinstance(value, str):
        return spoil(value) if key in _FREE else value
    if isinstance(value, list):
        return [spoilt(one, spoil, key=key) for one in value]
    if isinstance(value, dict):
        return {
            (spoil(name) if key == "packages" else name): spoilt(
                one, spoil, key="version" if key == "packages" else name
            )
            for name, one in value.items()
        }
    return value


@st.composite
def hostile_records(draw, directory=Path("nowhere")):
    """Records of any verdicts, gates and states, in which texts that differed still differ."""
    before, after, size = draw(SMALL), draw(SMALL), draw(SIZES)
    words = draw(st.lists(st.tuples(
        st.sampled_from(["supported", "violated", "undecided"]), st.booleans(),
        st.sampled_from(["C", "D"]), st.sampled_from(["i", "j"]),
        st.sampled_from(["a/clear", "a/clear+ghost"]),
    ), max_size=6))  # fmt: skip
    verdicts = [
        verdict(
            "SAF-1", case, ("satisfied", "violated"), component=component, item=item, verdict=word,
            waiver={"kind": "skip", "reason": "why"} if waived else None,
        )
        for word, waived, component, item, case in words
    ]  # fmt: skip
    gate = draw(st.sampled_from(["passed", "failed", "incomplete"]))
    status = draw(st.sampled_from(["complete", "running", "interrupted"]))
    searched = draw(st.sampled_from([(), ("falsified", "nothing found"), ("not repeatable",)]))
    mitigates = draw(st.sampled_from([["H"], ["H", "I"], []]))
    record = session_record(
        hazards=[hazard("H", "S2"), hazard("I")],
        requirements=[
            encode(REQUIREMENTS[name]) | ({"mitigates": mitigates} if mitigates else {})
            for name in sorted(REQUIREMENTS)
        ],
        verdicts=verdicts, status=status, searches=[entry(*searched)] if searched else [],
        gate={"result": gate, "exit_code": int(gate != "passed"), "reasons": ["r"] * (size % 7)},
        finished=draw(st.sampled_from([None, "2026-01-02T03:05:05+00:00"])),
    )  # fmt: skip
    return spoilt_record(record, lambda text: f"{before}{text}{after}" + "x" * size, directory)


def spoilt_record(record, spoil, directory):
    """The record with each text that may be any passed through ``spoil``; it fits the models."""
    before = record.to_json()
    after = spoilt(before, spoil)
    _restore(after, before)
    after["totals"] = totals(after)
    return SessionRecord.of(after, directory)


def _restore(told, before):
    """Put back the texts that cannot be any other: hashes, and words of which there are few."""
    try:
        decode(WholeRecord, told, 10**6)
    except MismatchError as error:
        for mismatch in error.mismatches:
            keys = mismatch.pointer.split("/")[1:]
            location = [int(key) if key.isdigit() else key for key in keys]
            here, there, last = told, before, None
            for key in location:
                if isinstance(here, (dict, list)) and (isinstance(key, int) or key in here):
                    parent, here, there, last = here, here[key], there[key], key
            parent[last] = there
