"""Signal temporal logic: parsed by rtamt, evaluated on NumPy columns."""
