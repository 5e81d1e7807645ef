"""The catalogue's fault types that know no domain, one module per family."""
