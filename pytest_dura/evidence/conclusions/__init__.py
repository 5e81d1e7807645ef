"""What follows from the lines of a session: one module for each table of its record."""
