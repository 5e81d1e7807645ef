"""Execution: who simulates the episodes of a session, and where they are kept."""
