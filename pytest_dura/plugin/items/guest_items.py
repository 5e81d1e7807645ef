"""Items that guests add to a session, each of which runs episodes of its own."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import pytest

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.guests import AddedItem, JudgedCase
from pytest_dura.plugin.items.markers import marked_requirements
from pytest_dura.plugin.items.outcomes import marked_target
from pytest_dura.plugin.items.scenario_items import AtRoot
from pytest_dura.plugin.messages import usage_errors

if TYPE_CHECKING:
    from pytest_dura.campaign.runner import Runner
    from pytest_dura.evidence.lines import Line
    from pytest_dura.plugin.context import SessionContext


class GuestItems(pytest.Collector):
    """Collector of the items of a guest, whose name stands before ``::`` in their node ids."""

    context: SessionContext
    added: Sequence[AddedItem]

    def collect(self) -> Iterator[pytest.Item]:
        """Yield the items."""
        fixtures = None
        for added in self.added:
            item = GuestItem.from_parent(self, name=added.name, callobj=_run, fixtureinfo=fixtures)
            fixtures = item._fixtureinfo  # noqa: SLF001 - the same for all of them
            item.items, item.added = self, added
            yield item


class GuestItem(AtRoot, pytest.Function):
    """Item that a guest adds."""

    items: GuestItems
    added: AddedItem

    def reportinfo(self) -> tuple[str, None, str]:
        """Return its name: it is of no file."""
        return self.items.name, None, self.nodeid


def guest_items(
    context: SessionContext, root: pytest.Session, items: Sequence[pytest.Item]
) -> list[pytest.Item]:
    """Collect the items that guests add to the tests and scenario items of a session.

    Raises:
        pytest.UsageError: If an option asks for items, and there is nothing to judge.
    """
    collected: list[pytest.Item] = []
    for name, guest in context.guests.named():
        with usage_errors():
            marked = _marked(context, items, guest.marker_arguments)
            added = guest.items(_planned(context), marked)
        if added:
            parent = GuestItems.from_parent(root, name=name, nodeid=name, path=context.root)
            parent.context, parent.added = context, added
            collected += root.genitems(parent)
    return collected


def expected_lines(context: SessionContext, chosen: Collection[str]) -> list[Line]:
    """Return what the record says of each planned item of guests until it has reported.

    Args:
        context: The session's context.
        chosen: Node ids of what will run.
    """
    return [
        added.waiting(
            "its item never reported"
            if f"{name}::{added.name}" in chosen
            else "the session left it out"
        )
        for name, guest in context.guests.named()
        for added in guest.expected(_planned(context))
    ]


def _planned(context: SessionContext) -> Iterator[JudgedCase]:
    """Yield the planned cases with their requirements; scenario files are read at the first."""
    for planned in context.plan:
        known = context.library().requirements
        judges = [known[name] for name in planned.requirements if name in known]
        yield JudgedCase(planned.case, judges, {})


def _marked(
    context: SessionContext, items: Iterable[pytest.Item], arguments: Collection[str]
) -> Iterator[JudgedCase]:
    """Yield the cases of tests on campaigns whose markers have one of these arguments."""
    for item in items:
        marker = item.get_closest_marker("dura")
        if marker is None or marker.kwargs.keys().isdisjoint(arguments):
            continue
        target = marked_target(item, ["campaign"])
        if target is not None:
            yield JudgedCase(target.case, marked_requirements(context, item), marker.kwargs)


def _run(request: pytest.FixtureRequest, _dura_roles: None, dura_orchestrator: Runner) -> None:
    """Run an item: the function that each calls."""
    item: GuestItem = request.node
    later = []
    if not item.items.context.is_worker:  # it does not know which items are its own
        items = item.session.items
        following = items[items.index(item) :]
        later = [
            each.added
            for each in following
            if isinstance(each, GuestItem) and each.items is item.items
        ]
    try:
        problem = item.added.run(dura_orchestrator, later)
    except ConfigurationError as error:
        problem = str(error)
    if problem:
        raise pytest.fail.Exception(problem, pytrace=False)
