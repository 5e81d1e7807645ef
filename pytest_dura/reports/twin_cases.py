"""Twin cases: those whose runs of the same seeds lack the faults or a role of another case."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from pytest_dura.evidence.case_model import CaseEntry
from pytest_dura.evidence.text import name
from pytest_dura.requirements.model import FAULTS


class TwinCase(NamedTuple):
    """A case whose runs are the twins of another case's.

    Args:
        without: What they lack: ``faults``, or a role; ``generator`` for those of a reference.
        id: Its id.
        component: Its component, which is another one for a reference.
        reference: The component that takes the place of the one under test; empty without one.
    """

    without: str
    id: str
    component: str
    reference: str = ""

    @property
    def text(self) -> str:
        """What sets its runs apart, in words."""
        if self.reference:
            return f"with {name(self.reference)} in its place"
        return f"without {'the faults' if self.without == FAULTS else name(self.without)}"


def twin_cases(cases: Sequence[CaseEntry]) -> dict[tuple[str, str], list[TwinCase]]:
    """List the twins of each case and component, those without faults first, references last.

    Args:
        cases: All cases of a record.
    """
    clean: dict[tuple[str, str, frozenset[str]], TwinCase] = {}
    lacking: dict[tuple[str, str, frozenset[str]], list[TwinCase]] = {}
    for case in cases:
        lacks = frozenset(case.without)
        if not case.faults:
            twin = TwinCase(FAULTS, case.id, case.component)
            clean.setdefault((case.scenario, case.component, lacks), twin)
        component = "" if case.reference else case.component
        for role in case.without:
            twin = TwinCase(role, case.id, case.component, case.reference or "")
            lacking.setdefault((_base(case), component, lacks - {role}), []).append(twin)
    twins: dict[tuple[str, str], list[TwinCase]] = {}
    for case in cases:
        lacks = frozenset(case.without)
        without_faults = clean.get((case.scenario, case.component, lacks))
        twins[case.id, case.component] = [
            *([without_faults] if case.faults and without_faults is not None else []),
            *lacking.get((_base(case), case.component, lacks), ()),
            *lacking.get((_base(case), "", lacks), ()),
        ]
    return twins


def _base(case: CaseEntry) -> str:
    """Id of a case with all roles."""
    return case.id.partition("~")[0]
