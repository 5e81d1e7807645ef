"""Adapters: simulators of other libraries. Each imports its library at first use."""
