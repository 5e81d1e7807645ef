"""The component under test: how much insulin the pump delivers, every five minutes."""

from __future__ import annotations

from insulin_pump import BASAL_RATE, Monitor, Pump

from pytest_dura import Generator, GeneratorView, Proposal


class Controller(Generator):
    """Delivers more the higher glucose is and the faster it rises; stops while it is low.

    Args:
        target: In mg/dL.
        low: Below it, or where it will be within half an hour, nothing is delivered; in mg/dL.
    """

    def __init__(self, target: float = 110.0, low: float = 85.0) -> None:
        self.target, self.low = target, low
        self._last: float | None = None

    def propose(self, view: GeneratorView) -> Proposal:
        """Return the rate, with the reason."""
        cgm: Monitor = view.percept["cgm"]
        rise = 0.0 if self._last is None else (cgm.glucose - self._last) / 5.0
        self._last = cgm.glucose
        if min(cgm.glucose, cgm.glucose + 30.0 * rise) < self.low:
            return Proposal(Pump(0.0), f"{cgm.glucose:.0f} mg/dL is or will be low")
        rate = BASAL_RATE + 0.3 * (cgm.glucose - self.target) + 6.0 * max(rise, 0.0)
        return Proposal(Pump(min(max(rate, 0.0), 100.0)), f"{cgm.glucose:.0f} mg/dL, {rise:+.1f}")
