"""Traces: an episode tick by tick, on disk as MCAP and for the player of the report."""
