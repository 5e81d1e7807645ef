"""What is asked of pytest instead of a session, or printed by a command."""
