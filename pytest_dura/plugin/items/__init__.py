"""What a test or a scenario becomes in a session: items, their fixtures, markers and outcomes."""
