"""Faults on the way to a language model: of its prompt, and of how its server is reached."""
