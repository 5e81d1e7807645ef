"""Monitors: a formula as one, what they reported, and how good they are."""
