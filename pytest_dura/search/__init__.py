"""Search for counterexamples: spaces, searchers, confirmation, and shrinking."""
