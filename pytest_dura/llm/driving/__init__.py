"""The language model as a tactical planner for driving."""
