"""Fields of a record that a forger may change unseen; ``python tests/support/forged_fields.py``.

It writes what ``docs/trust.md`` says of them: the list from here, the table from the test that
forges each field (``tests/plugin/test_verify_forged.py``).
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
PAGE = REPOSITORY / "docs" / "trust.md"
FINDERS = ("form", "contradiction", "conclusion", "trace")
FREE = {
    "who wrote it, where, when and how fast, which nothing else in it repeats": """
        created, finished, command, tool, environment, execution, resume.session, resume.sources,
        selection,
        require_repeatable, timings.wall_seconds, timings.evidence_seconds,
        episodes[].metrics.processing_us, inputs
    """,
    "what was asked for, in the words of its own file": """
        requirements[].text, requirements[].kind, requirements[].source, requirements[].reason,
        requirements[].method, requirements[].p0, requirements[].at_most (null),
        requirements[].paired,
        cases[].without[], cases[].faults[].duration, cases[].faults[].by_chance,
        cases[].faults[].activation, cases[].faults[].parameters
    """,
    "what the component is, beside its name and the digest of its code": """
        component_under_test.path, component_under_test.version, component_under_test.opaque,
        component_under_test.distribution, component_under_test.files,
        component_under_test.digest (null), component_under_test.others[].path,
        component_under_test.others[].version, component_under_test.others[].opaque,
        component_under_test.others[].distribution, component_under_test.others[].files,
        component_under_test.others[].digest (null)
    """,
    "what an episode was simulated from: simulating it again tells": """
        episodes[].spec.roles, episodes[].spec.simulator, episodes[].spec.termination,
        episodes[].spec.time_budget,
        episodes[].spec.faults[].duration, episodes[].spec.faults[].by_chance,
        episodes[].spec.faults[].activation, episodes[].spec.faults[].parameters
    """,
    "what was seen in an episode, and is in no trace: simulating it again tells": """
        cases[].repeat (null), cases[].repeat.detail, episodes[].trajectory, episodes[].drawn,
        episodes[].metrics.robustness_min, episodes[].metrics.violations,
        episodes[].metrics.recoveries_succeeded, episodes[].faults[].planned_at,
        episodes[].faults[].deactivated_at, episodes[].faults[].detected_by,
        episodes[].faults[].pattern, episodes[].faults[].recovery,
        episodes[].faults[].recovery_at, episodes[].faults[].activations,
        episodes[].faults[].manifest_ticks, episodes[].faults[].by_chance,
        episodes[].faults[].read_by,
        episodes[].faults[].propagation, episodes[].faults[].propagated_at,
        episodes[].faults[].unknown, judgements[].runs[].twin_verdict.margin,
        judgements[].runs[].twin_verdict.time, judgements[].runs[].twin_verdict.detail,
        monitors[].untimed, monitors[].invalid, monitors[].missing,
        monitors[].false_alarms, monitors[].horizon (other)
    """,
    "what a test asserted: running it tells": """
        judgements[].assertion.alone, judgements[].assertion.observed
    """,
    "what was to be decided, where it was": """
        judgements (fewer)
    """,
    "the name of a test that failed": """
        failed_items[]
    """,
    "what a search did, of which no verdict is made: searching again tells": """
        searches[].seed, searches[].budget, searches[].refused, searches[].rule,
        searches[].parameters, searches[].searchers[].trivial,
        searches[].searchers[].first.* (null), searches[].baselines (fewer),
        searches[].baselines[].name, searches[].baselines[].best.*,
        searches[].baselines[].first.* (null), searches[].coverage, searches[].simulator,
        searches[].roles, searches[].item
    """,
    "what a search found: replaying the counterexample tells": """
        searches[].outcomes[].counterexample.case, searches[].outcomes[].counterexample.scenario,
        searches[].outcomes[].counterexample.digest, searches[].outcomes[].counterexample.margin,
        searches[].outcomes[].counterexample.time, searches[].outcomes[].counterexample.detail,
        searches[].outcomes[].counterexample.shrinking (null),
        searches[].outcomes[].counterexample.shrinking.before,
        searches[].outcomes[].counterexample.shrinking.budget,
        searches[].outcomes[].counterexample.shrinking.finished,
        searches[].outcomes[].counterexample.file (other),
        searches[].outcomes[].counterexample.name (other)
    """,
}
"""Fields from which nothing else in a bundle follows, and why; with all that is below them."""


def free_names() -> list[str]:
    return [name.strip() for names in FREE.values() for name in names.split(",")]


def table_rows(table: Mapping[str, Counter[str]]) -> Iterator[str]:
    """Yield the rows of the page: what finds the values of each key, and how many nothing does."""
    for name, counts in sorted(table.items()):
        found = [counts[finder] for finder in FINDERS]
        cells = map(str, (counts["values"], *found, counts["values"] - sum(found)))
        yield f"| `{name}` | {' | '.join(cells)} |"


ROWS = re.compile(r"(?:^\| `\w+` \|(?: \d+ \|){6}\n)+", re.MULTILINE)
LISTED = re.compile(r"(?<=with all that is below them:\n\n)(?:^- .*\n)+", re.MULTILINE)


def rows_of(page: str) -> list[str]:
    return ROWS.search(page)[0].splitlines()


def updated_page(page: str, rows: Sequence[str] = ()) -> str:
    """Return the page with the list as it is now, and with rows if there are some."""
    listed = "".join(
        f"- {why}: {', '.join(f'`{name.strip()}`' for name in names.split(','))}\n"
        for why, names in FREE.items()
    )
    page = LISTED.sub(lambda _: listed, page)
    return ROWS.sub(lambda _: "".join(f"{row}\n" for row in rows), page) if rows else page


def rows_of_the_test() -> list[str]:
    """Forge each field, and return the rows that the test prints."""
    test = "tests/plugin/test_verify_forged.py"
    done = subprocess.run(
        [sys.executable, "-m", "pytest", test, "-k", "whatever_field_it_is", "-rA"],
        cwd=REPOSITORY, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return rows_of(done.stdout)


if __name__ == "__main__":
    PAGE.write_text(updated_page(PAGE.read_text("utf-8"), rows_of_the_test()), "utf-8")
