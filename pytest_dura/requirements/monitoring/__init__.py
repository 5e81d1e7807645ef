"""Monitors: a formula as one, what they said, and how good they are."""
