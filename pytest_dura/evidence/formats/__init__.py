"""One module per output format: each renders the record, and reads its own counts back."""
