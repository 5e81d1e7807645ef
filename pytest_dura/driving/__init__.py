"""The autonomous-driving domain: bodies, geometry, maneuvers, sensors, simulators, roles, faults."""
