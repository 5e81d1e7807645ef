"""Requirements: formulas, statistics, and verdicts on episodes, pairs and campaigns."""
