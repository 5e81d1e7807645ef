"""Fault types that know no domain, one module per family."""
