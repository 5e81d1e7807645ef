"""Readers of formats, each over a library of that format, registered by entry points."""
