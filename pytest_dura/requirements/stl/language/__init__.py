"""The language: from a formula's text to its nodes, and the messages that point into it."""
