"""Drafts: requirements that a language model writes from a sentence."""
