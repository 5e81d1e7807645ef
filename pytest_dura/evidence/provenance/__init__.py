"""Provenance: where a session ran, on what machine, and from which files."""
