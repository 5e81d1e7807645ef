"""Recorded logs as episodes: judged by the same requirements, recorded and not run."""
