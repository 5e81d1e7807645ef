"""A weeding robot in a field of plants, as a domain of pytest-dura."""
