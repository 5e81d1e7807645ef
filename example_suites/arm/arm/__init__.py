"""A robot arm and a person beside it, as a domain of pytest-dura."""
