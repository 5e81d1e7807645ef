"""A formula that looks back, sample by sample while an episode runs."""
