"""A mobile robot with differential drive, as a domain of pytest-dura."""
