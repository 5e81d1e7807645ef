"""Options of ``--dura-qualify``."""

from __future__ import annotations

import math

from pytest_dura.options import Option, OptionTable, Setting, switch, unusable

_WHOLE_SUITE = "the share of seeded defects that are caught is that of a whole suite"


def _share(setting: Setting) -> float:
    """Read a share above 0 and up to 1."""
    try:
        number = float(setting.value)
    except ValueError:
        number = math.nan
    if not 0.0 < number <= 1.0:
        raise unusable(
            f"{setting.key} is a share",
            key=setting.key,
            found=setting.value,
            expected="a number above 0, and at most 1",
            remedy=f"such as {setting.key}=0.8",
        )
    return number


class QualificationOptions(OptionTable):
    """Options that ask what a suite catches of seeded defects."""

    title = "what the suite catches of seeded defects"

    switched_on: Option[bool] = Option(
        "--dura-qualify",
        "run the gate on seeded defects of what the suite rests on, and say which requirement "
        "catches which, in how many runs",
        switch,
        details="With --dura-scenarios. See [qualifying a suite](how-to/qualify.md).",
        activates=True,
        no_shard=_WHOLE_SUITE,
    )
    at_least: Option[float | None] = Option(
        "--dura-qualify-at-least",
        "share of the seeded defects that the suite has to catch, or the gate fails; it implies "
        "--dura-qualify",
        _share,
        metavar="SHARE",
        example="0.8",
        activates=True,
        no_shard=_WHOLE_SUITE,
    )

    @property
    def qualifies(self) -> bool:
        """Whether an option asks for seeded defects."""
        return self.switched_on or self.at_least is not None
