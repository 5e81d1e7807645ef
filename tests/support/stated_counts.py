"""The totals that a rendered text states, read without the code that wrote it; and dead links."""

from __future__ import annotations

import json
import re
from collections import Counter
from html.parser import HTMLParser
from urllib.parse import unquote
from xml.etree import ElementTree as ET

import yaml
from gsn_rules import rule_problems

STATUSES = ("supported", "violated", "undecided")
EPISODES = ("episodes", "valid", "invalid", "missing")
KEYS = ("gate", "requirements", "cases", *EPISODES, *STATUSES, "waived")


def stated_counts(name, text):
    """The totals in a text, counted in its rows and elements as far as it lists them.

    Args:
        name: Of the file, or the module of its format.
        text: The file's text.
    """
    return _READERS[getattr(name, "FILE", name)](text)


def _of_summary(text):
    header = f"| {' | '.join(KEYS)} |\n|{' --- |' * len(KEYS)}\n| "
    row = text.partition(header)[2].partition(" |\n")[0].split(" | ")
    stated = dict(zip(KEYS, row, strict=True))
    stated |= {key: int(value) for key, value in stated.items() if key != "gate"}
    for heading in ("Requirements", "Cases", "Verdicts"):
        body = text.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
        if re.search(r"^_\d+ of \d+ are left out", body, re.MULTILINE):
            continue
        if heading != "Verdicts":
            # The first two rows are the header and its rule, the last ones may be sums.
            rows = [line for line in body.split("\n") if line.startswith("| ")]
            stated[heading.lower()] = sum(not row.startswith("| All ") for row in rows) - 2
            continue
        rows = re.findall(r"(?m)^\| (supported|violated|undecided) \| (waived|-) \|", body)
        statuses = Counter(status for status, _ in rows)
        stated |= {status: statuses[status] for status in STATUSES}
        stated["waived"] = sum(waiver == "waived" for _, waiver in rows)
    return stated


class _ReportParser(HTMLParser):
    """Counts the rows of the tables of verdicts and of cases, with the episodes of each."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.counts, self.gates = Counter(), set()
        self.table, self.row, self.text, self.mark = "", None, [], ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        kinds = (attributes.get("class") or "").split()
        if tag == "table":
            self.table = attributes.get("id") or ""
        elif tag == "tbody":
            self.counts["requirements"] += self.table == "verdicts" and "requirement" in kinds
            self.counts["cases"] += self.table == "outcomes" and "entry" in kinds
        elif tag == "tr":
            self.row = {"kinds": kinds, "cells": [], "folded": 0, "waived": False, "word": ""}
        elif tag in ("td", "th", "b", "strong"):
            self.text = []
            self.mark = "".join(kinds) if tag in ("b", "strong") else ""

    def handle_data(self, data):
        self.text.append(data)

    def handle_endtag(self, tag):
        text = "".join(self.text).strip()
        if tag in ("b", "strong") and self.mark:
            if self.mark == "gate-word":
                self.gates.add(text)
            elif self.row is not None and self.mark in ("word", "waived"):
                self.row[self.mark] = text
            elif self.row is not None and self.mark == "folded-supported":
                self.row["folded"] = int(text)
            elif self.mark == "folded-cases":
                self.counts["cases"] += int(text)
            elif self.mark.startswith("counted-"):
                self.counts[self.mark.removeprefix("counted-")] += int(text)
            self.mark = ""
        elif tag in ("td", "th") and self.row is not None:
            self.row["cells"].append(text)
        elif tag == "tr" and self.row is not None:
            self.end_row(self.row)
            self.row = None
        elif tag == "table":
            self.table = ""

    def end_row(self, row):
        if self.table == "verdicts" and "verdict" in row["kinds"]:
            self.counts[row["word"]] += 1
            self.counts["waived"] += bool(row["waived"])
        elif self.table == "verdicts" and "folded" in row["kinds"]:
            self.counts["supported"] += row["folded"]


def _of_report(text):
    page = _ReportParser(text)
    (gate,) = page.gates
    return {"gate": gate, **{key: page.counts[key] for key in KEYS[1:]}}


def _of_declarations(text):
    document = json.loads(text)
    stated = {entry["name"]: entry["value"] for entry in document["metadata"]["properties"]}
    counts = {key: int(stated[f"pytest-dura:{key}"]) for key in ("cases", *EPISODES)}
    counts["gate"] = stated["pytest-dura:gate"]
    counts["requirements"] = len(document["definitions"]["standards"][0]["requirements"])
    declared = document["declarations"]
    entries = {entry["bom-ref"]: entry for entry in declared["evidence"]}
    mapped = Counter(
        (ref, place)
        for attestation in declared["attestations"]
        for mapping in attestation["map"]
        for place in ("claims", "counterClaims")
        for ref in mapping[place]
    )
    statuses = Counter()
    for claim in declared["claims"]:
        evidence = entries[claim["evidence"][0]]
        status = evidence["propertyName"].removeprefix("pytest-dura:verdict:")
        assert mapped.pop(
            (claim["bom-ref"], "counterClaims" if status == "violated" else "claims")
        ) == 1  # fmt: skip
        statuses[status] += 1
        statuses["waived"] += any(data["name"] == "waiver" for data in evidence["data"])
    assert not mapped
    return counts | {key: statuses[key] for key in (*STATUSES, "waived")}


def _of_statement(text):
    predicate = json.loads(text)["predicate"]
    annotations = predicate["configuration"][0]["annotations"]
    passed, failed, warned = (
        predicate[f"{kind}Tests"] for kind in ("passed", "failed", "warned")
    )  # fmt: skip
    tests = [*passed, *failed, *warned]
    named = {status: set(annotations[status]) for status in ("violated", "undecided")}
    bad = named["violated"] | named["undecided"]
    assert len(set(tests)) == len(tests)
    assert bad <= set(tests)
    assert set(failed) <= bad
    assert not bad & set(passed)
    return {
        "gate": annotations["gate"],
        **{key: int(annotations[key]) for key in ("requirements", "cases", *EPISODES)},
        "supported": len(tests) - len(bad),
        **{status: len(names) for status, names in named.items()},
        "waived": len(warned),
    }


def elements_of(text):
    """The elements of an argument in YAML, without the module that it begins with."""
    elements = yaml.safe_load(text)
    del elements["module"]
    return elements


def _of_argument(text):
    elements = elements_of(text)
    assert rule_problems(elements) == []
    (session,) = [each for each in elements.values() if each.get("alias") == "context:session"]
    counted = Counter()
    for element in elements.values():
        what = str(element.get("alias", "")).partition(":")[0]
        if what == "requirement":
            counted["requirements"] += 1
        elif what == "waiver":
            counted["waived"] += 1
        elif what == "verdict":
            drawn = "violated" if element.get("defeated") else "supported"
            drawn = "undecided" if element.get("undeveloped") else drawn
            assert element["verdict"] == drawn
            counted[drawn] += 1
    stated = {key: int(session[key]) for key in ("cases", *EPISODES)}
    return {"gate": session["gate"], **stated, **{key: counted[key] for key in _COUNTED}}


_COUNTED = (*STATUSES, "requirements", "waived")


def _of_picture(text):
    groups = [group.attrib for group in ET.fromstring(text).iter() if "data-id" in group.attrib]
    (session,) = [group for group in groups if "data-gate" in group]
    sums = {key: sum(int(group.get(f"data-{key}", 0)) for group in groups) for key in _COUNTED}
    for group in groups:
        statuses = [status for status in STATUSES if f"data-{status}" in group]
        if group["data-kind"] == "Goal" and len(statuses) == 1 and "data-requirements" not in group:
            drawn = "undecided" if "data-undeveloped" in group else "supported"
            assert statuses == ["violated" if "data-defeated" in group else drawn]
    stated = {key: int(session[f"data-{key}"]) for key in ("cases", *EPISODES)}
    return {"gate": session["data-gate"], **stated, **sums}


def _of_needs(text):
    document = json.loads(text)
    (version,) = document["versions"].values()
    needs = version["needs"]
    assert version["needs_amount"] == len(needs)
    assert all(need["id"] == id_ for id_, need in needs.items())
    assert all(link in needs for need in needs.values() for link in need["links"])
    parts = (part.rpartition(" ") for part in needs["SESSION"]["totals"].split(", "))
    stated = {key: value if key == "gate" else int(value) for key, _, value in parts}
    types = Counter(need["type"] for need in needs.values())
    verdicts = [need for need in needs.values() if need["type"] == "verdict"]
    statuses = Counter(need["status"] for need in verdicts)
    return {
        **{key: stated[key] for key in ("gate", *EPISODES)},
        "requirements": types["requirement"],
        "cases": types["testcase"],
        **{status: statuses[status] for status in STATUSES},
        "waived": sum("waived" in need["tags"] for need in verdicts),
    }


_READERS = {
    "needs.json": _of_needs,
    "summary.md": _of_summary,
    "report.html": _of_report,
    "cyclonedx.json": _of_declarations,
    "test-result.intoto.json": _of_statement,
    "assurance-case.gsn.yaml": _of_argument,
    "assurance-case.svg": _of_picture,
}


def dead_references(text, record):
    """References of declarations or of an argument that lead nowhere, in it or in the bundle."""
    return list(_dead_in_declarations(text, record) if text[0] == "{" else _dead(text, record))


def _dead(text, record):
    for name, element in elements_of(text).items():
        here, url = record.head, str(element.get("url", ""))
        if url.startswith("evidence.json#/"):
            try:
                for key in url.partition("#/")[2].split("/"):
                    here = here[int(key)] if isinstance(here, (list, tuple)) else getattr(here, key)
            except (LookupError, ValueError, AttributeError):
                yield f"{name} refers to {url}, which is not there"
        trace = element.get("trace")
        if trace is not None and not (record.directory / str(trace)).is_file():
            yield f"{name} refers to {trace}"


_LINKS = ("assessor", "requirement", "target", "parent")
_LISTS = ("claims", "counterClaims", "evidence", "counterEvidence", "mitigationStrategies")


def _dead_in_declarations(text, record):
    document = json.loads(text)
    refs = Counter(_bom_refs(document))
    yield from (f"the bom-ref {ref} is given {n} times" for ref, n in refs.items() if n > 1)
    declared = document["declarations"]
    holders = list(declared["claims"])
    for attestation in declared["attestations"]:
        holders.append(attestation)
        for mapping in attestation["map"]:
            holders += [mapping, mapping.get("conformance", {})]
    for standard in document["definitions"]["standards"]:
        holders += standard["requirements"]
    for holder in holders:
        named = [holder[key] for key in _LINKS if key in holder]
        named += [ref for key in _LISTS for ref in holder.get(key, ())]
        yield from (f"{holder.get('bom-ref')} refers to {ref}" for ref in named if ref not in refs)
    places = {f"evidence.json#/verdicts/{number}" for number in range(len(record.head.verdicts))}
    for number, episode in enumerate(record.episodes()):
        places.add(f"evidence.json#/episodes/{number}")
        if episode.trace is not None:
            places.add(episode.trace.file)
    for entry in declared["evidence"]:
        for data in entry["data"]:
            url = data["contents"].get("url")
            if url is not None and unquote(url, errors="surrogatepass") not in places:
                yield f"{entry['bom-ref']} refers to {url}"


def _bom_refs(value):
    if isinstance(value, dict):
        if "bom-ref" in value:
            yield value["bom-ref"]
        value = list(value.values())
    if isinstance(value, list):
        for element in value:
            yield from _bom_refs(element)
