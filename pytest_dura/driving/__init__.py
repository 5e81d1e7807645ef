"""The autonomous-driving domain: bodies, geometry, sensors, simulators, roles and faults."""
