"""The fault catalogue, activation and duration, composition, and the injector role."""
