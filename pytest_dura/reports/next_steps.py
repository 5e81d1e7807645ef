"""Next steps: what to look at after a violation, as it follows from the situation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pytest_dura.core.episode import RECORDED
from pytest_dura.core.metrics import TracedFault
from pytest_dura.core.state import Event
from pytest_dura.evidence.conclusions.effectiveness import RECOVERY_ROLE
from pytest_dura.evidence.text import name
from pytest_dura.reports.incidents import (
    OWN_FAILURE,
    TICK,
    BriefRun,
    Incident,
    TwinOutcome,
    manifested,
    own_failure_step,
)
from pytest_dura.reports.wording import names_text
from pytest_dura.requirements.model import FAULTS


def next_step(incident: Incident, twins: Sequence[TwinOutcome]) -> str:
    """Say what to look at next.

    Args:
        incident: The violations of one episode.
        twins: What the runs of the same seed did.
    """
    brief = incident.brief
    if brief is None:
        return "Run its case again: the record does not hold the episode."
    return next(_steps(incident, brief, twins))


def _steps(incident: Incident, brief: BriefRun, twins: Sequence[TwinOutcome]) -> Iterator[str]:
    """Steps that the situation calls for, the most pressing first; at least one."""
    component, time = name(incident.component), incident.worst.counterexample.time
    if incident.event is not None and incident.event.kind == OWN_FAILURE:
        yield own_failure_step(component, incident.event.detail)
    yield from _steps_without_fault(incident, brief, twins)
    active = manifested(brief, time)
    if incident.compares_faults and active:
        yield _next_on_fault(active[0], component, time)
    before = [event for event in brief.telling if time is None or event.time <= time + TICK]
    recovered = [event for event in before if event.kind == "recovery"]
    unaided = next((twin for twin in twins if twin.without == RECOVERY_ROLE), None)
    if recovered and unaided is not None:
        kind = incident.worst.requirement.kind
        yield _next_on_recovery(recovered[-1], component, kind, unaided)
    if active:
        yield _next_on_fault(active[0], component, time)
    if recovered:
        yield _replay_from(recovered[-1], component)
    if any(event.kind in ("unsafe", "security") for event in before):
        yield (
            f"A monitor objected and recovery did not act: look at its policy, and at {component}."
        )
    if brief.termination == RECORDED:
        until = "its end" if time is None else f"t = {time:.2f} s"
        yield (
            f"Look at what the log shows until {until}; where it has poses, "
            "`python -m pytest_dura logs scenario-from-log` makes a scenario of it."
        )
    yield (
        f"No monitor objected before: replay it, see what {component} proposed, and whether a "
        "monitor should see it."
    )


def _steps_without_fault(
    incident: Incident, brief: BriefRun, twins: Sequence[TwinOutcome]
) -> Iterator[str]:
    """Steps where the violation is none of the faults' doing."""
    component, counterexample = name(incident.component), incident.worst.counterexample
    if not counterexample.valid:
        names = names_text([fault.id for fault in brief.faults])
        yield (
            f"No role read anything that {names} changed: look at {component}, and let the fault "
            "begin where it is read."
        )
    if any(twin.violates for twin in twins if twin.without == FAULTS):
        yield f"It is violated without the fault as well: look at {component}, not at the fault."
    if brief.faults and not manifested(brief, counterexample.time):
        yield f"No fault had an effect yet: look at {component}, not at the fault."


def _next_on_recovery(recovery: Event, component: str, kind: str, unaided: TwinOutcome) -> str:
    """What to look at where recovery had acted and the run without it is known."""
    action = name(recovery.subject)
    if unaided.violates or unaided.same_end:
        return (
            f"The run without {name(unaided.without)} came to the same: look at {component}, "
            f"and not at recovery ({action})."
        )
    if not unaided.grave:
        return (
            f"Recovery ({action}) acted, and the run without it came to nothing grave: look at "
            "what called it, and at when it hands control back."
        )
    if kind == "recovery":
        return (
            f"Recovery ({action}) spared this run what happened without it: look at what "
            f"{component} proposed before t = {recovery.time:.2f} s, then at how recovery acts."
        )
    return _replay_from(recovery, component)


def _replay_from(recovery: Event, component: str) -> str:
    return (
        f"Recovery ({name(recovery.subject)}) did not prevent it: replay it from "
        f"t = {recovery.time:.2f} s, and look at what {component} proposed before."
    )


def _next_on_fault(fault: TracedFault, component: str, time: float | None) -> str:
    """What to look at where a fault had an effect before the violation."""
    detected, recovered = fault.detected_at, fault.recovery_at
    identity = name(fault.id)
    if detected is None or (time is not None and detected > time + TICK):
        return (
            f"No monitor had detected {identity} by then: look at what would detect it, or make "
            f"{component} withstand it."
        )
    who = f"{name(fault.detected_by or 'a monitor')} detected {identity} at t = {detected:.2f} s"
    if recovered is None or (time is not None and recovered > time + TICK):
        return f"{who}, and recovery had not acted: look at what activates it."
    return f"{who}, and recovery did not prevent it: look at what it does, and how early."
