"""How pytest-xdist spreads our items over its workers."""

from __future__ import annotations

from xdist.scheduler import LoadScopeScheduling


class CaseScheduling(LoadScopeScheduling):  # type: ignore[misc, unused-ignore]
    """Load balancing in units: the items of a case together, any other item on its own."""

    def _split_scope(self, nodeid: str) -> str:
        name, bracket, parameters = nodeid.partition("[")
        if bracket:
            # A test on runs or cases: `name[intersection/nominal#3]`, maybe among other parameters.
            return parameters.partition("#")[0].rstrip("]")
        return name if ".py::" in name else name.rpartition("::")[0]
