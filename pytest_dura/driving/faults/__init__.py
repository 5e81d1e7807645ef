"""Faults of the driving domain: on the list of objects, on the pose, and on what signs say."""
