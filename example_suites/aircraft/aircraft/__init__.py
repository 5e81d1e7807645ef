"""A light aircraft on JSBSim, as a domain of pytest-dura."""
