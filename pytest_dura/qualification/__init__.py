"""Qualification of a suite: what it catches of defects that are seeded into what it rests on."""

from pytest_dura.public_names import imported_on_use

__getattr__, __dir__ = imported_on_use(__name__, __file__)
