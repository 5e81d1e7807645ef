from .activation import Activation, AttackPlan
from .catalogue import (
    FAULT_TYPES,
    default_fault,
    fault_class,
    fault_effect,
    fault_form,
    parse_fault,
)
from .conditions import parse_condition
from .injector import CampaignInjector
from .model import (
    Channel,
    FaultEffect,
    Kind,
    Moment,
    check_condition_targets,
    check_target,
    possible_targets,
)
from .parts import Choices, FaultPart, Finite, RefusedError, Span, spans_of
from .types.base import NumberFault

__all__ = [
    "FAULT_TYPES",
    "Activation",
    "AttackPlan",
    "CampaignInjector",
    "Channel",
    "Choices",
    "FaultEffect",
    "FaultPart",
    "Finite",
    "Kind",
    "Moment",
    "NumberFault",
    "RefusedError",
    "Span",
    "check_condition_targets",
    "check_target",
    "default_fault",
    "fault_class",
    "fault_effect",
    "fault_form",
    "parse_condition",
    "parse_fault",
    "possible_targets",
    "spans_of",
]
