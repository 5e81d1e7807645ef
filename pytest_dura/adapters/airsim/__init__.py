"""AirSim by the client of Cosys-AirSim: a multirotor that flies to a place.

No server of AirSim has been run with this; ``python -m pytest_dura.adapters.airsim check`` is what
to run first where there is one.
"""
