"""Mutations of each part that fit any domain; domains bring their own beside them."""
