"""CARLA by its client library: a junction of its maps, or one that it builds, in step.

No server of CARLA has been run with this so far; ``python -m pytest_dura.adapters.carla check`` is
what to run first where there is one.
"""
