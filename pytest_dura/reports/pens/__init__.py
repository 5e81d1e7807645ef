"""Pens: each writes a document in one format."""
