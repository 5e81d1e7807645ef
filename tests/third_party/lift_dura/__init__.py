"""A lift: one of each thing that a package can register."""
