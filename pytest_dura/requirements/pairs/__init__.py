"""Pairs: episodes of equal seeds, with something and without it."""
