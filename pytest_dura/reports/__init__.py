"""Reports: every file that is rendered from the evidence record."""
