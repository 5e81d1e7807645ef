from .altered import AlteredPercept, with_numbers
from .mutant import MUTANTS, Mutant, Mutation, Parameter
from .qualifying import AnyMutant, Gate, Qualification, planned_mutants
from .results import NAME, Kill, Margin, Qualified
from .table import qualification_objections

__all__ = [
    "MUTANTS",
    "NAME",
    "AlteredPercept",
    "AnyMutant",
    "Gate",
    "Kill",
    "Margin",
    "Mutant",
    "Mutation",
    "Parameter",
    "Qualification",
    "Qualified",
    "planned_mutants",
    "qualification_objections",
    "with_numbers",
]
