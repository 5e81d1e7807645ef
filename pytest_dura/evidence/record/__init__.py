"""The evidence record: what items tell, gathered and summed up as plain data."""
