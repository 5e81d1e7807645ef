"""Adapters: other people's simulators as ours. Each imports its library at first use."""
