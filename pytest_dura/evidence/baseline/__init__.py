"""The baseline: an earlier record, and what the rates of violations did since."""
