"""What a session leaves behind: the evidence record and how it is written and read."""
