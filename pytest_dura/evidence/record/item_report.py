"""ItemReport: what one test item tells the record."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

Data = dict[str, Any]

EPISODES_AT_ONCE = 64
"""Records of episodes that a process holds as they are; more of them are told or packed."""
_PART = ("components", "cases", "requirements", "episodes", "chains")


@dataclass
class ItemReport:
    """What one test item tells; plain data, which crosses processes as JSON.

    Args:
        item: Node id.
        components: Components under test, of :func:`describe_component`.
        sources: SHA-256 of the files of components by their names, by the components' digests.
        cases: ``{id, scenario, faults, component, requirements, planned}``.
        requirements: ``Requirement.to_json()`` of each requirement involved.
        episodes: Of :func:`episode_record`.
        verdicts: ``CampaignVerdict.to_json()``, with the ``check`` and ``paired`` of the
            requirement that was judged.
        outcomes: ``EpisodeVerdict.to_json()`` of tests that look at one episode, with ``case``,
            ``planned``, the ``at_most`` and ``confidence`` of the requirement, and the
            ``assertion`` of the test: what it looked at, and what failed.
        searches: ``Falsification.to_json()``, with the ``scenario`` of its case, the ``simulator``
            and the ``roles``.
        monitors: ``MonitorQuality.to_json()``, with the ``case`` that it was measured on.
        chains: What came of each fault, with the ``episode`` and its ``case``.
        claims: ``{requirement, case, each_run}`` of what the item is to decide, told before it.
        traces: ``{id, component, digest, trace}`` of episodes whose trace was written.
        models: Language models that were used, as the record's ``models`` has them, with what this
            ``process`` has asked them since it began.
        problems: What casts doubt on the whole session, each beginning with ``infrastructure:``.
        objections: What else stands against the session, whatever its verdicts say.
        notes: What the user should know of the session and casts no doubt on it.
        searched: ``{run, origin}`` of simulations of searches, where earlier sessions may have made
            them; ``run`` tells them apart.
        repeats: What came of repeating an episode of a ``case`` with a ``component``, as the
            record's cases have it.
        parts: Packed reports with earlier episodes of the item.
    """

    item: str
    components: list[Data] = field(default_factory=list)
    sources: dict[str, dict[str, str]] = field(default_factory=dict)
    cases: list[Data] = field(default_factory=list)
    requirements: list[Data] = field(default_factory=list)
    episodes: list[Data] = field(default_factory=list)
    verdicts: list[Data] = field(default_factory=list)
    outcomes: list[Data] = field(default_factory=list)
    searches: list[Data] = field(default_factory=list)
    monitors: list[Data] = field(default_factory=list)
    chains: list[Data] = field(default_factory=list)
    claims: list[Data] = field(default_factory=list)
    traces: list[Data] = field(default_factory=list)
    models: list[Data] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    objections: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    searched: list[Data] = field(default_factory=list)
    repeats: list[Data] = field(default_factory=list)
    parts: list[str] = field(default_factory=list)

    def to_json(self) -> Data:
        """Plain data."""
        return dict(vars(self))

    def __bool__(self) -> bool:
        """Whether there is anything to tell."""
        return any(value for name, value in vars(self).items() if name != "item")

    @property
    def full(self) -> bool:
        """Whether its episodes are so many that they should go."""
        return len(self.episodes) + len(self.chains) >= EPISODES_AT_ONCE

    def without_secrets(self, redact: Callable[[Any], Any]) -> ItemReport:
        """The same report as it may be told; what is packed has lost its secrets before."""
        return ItemReport(**{**redact({**self.to_json(), "parts": []}), "parts": self.parts})

    def split(self, redact: Callable[[Any], Any]) -> str:
        """Take the episodes out of it, as a packed report that makes sense on its own.

        Args:
            redact: Takes secrets out of plain data.
        """
        part = ItemReport("", **{name: getattr(self, name) for name in _PART})
        self.episodes, self.chains = [], []
        text = json.dumps(part.without_secrets(redact).to_json(), allow_nan=False)
        return base64.b64encode(zlib.compress(text.encode(), 1)).decode()


def unpacked(part: str) -> Data:
    """The report of :meth:`ItemReport.split`."""
    found: Data = json.loads(zlib.decompress(base64.b64decode(part)))
    return found
