"""The cassette: one SQLite file with what a language model was asked and what it answered."""
