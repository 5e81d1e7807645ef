"""Signal temporal logic: parsed and evaluated on NumPy columns, by one table of operators."""
