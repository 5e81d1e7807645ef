"""Files: scenarios, requirements, cases and fault campaigns, read and checked."""
