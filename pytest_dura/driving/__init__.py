"""The autonomous-driving domain: bodies, geometry, sensors, simulators, roles and faults."""

from pytest_dura.public_names import imported_on_use

__getattr__, __dir__ = imported_on_use(__name__, __file__)
