"""The six roles for driving."""
