"""Plots of a session: one module for each kind of picture."""
