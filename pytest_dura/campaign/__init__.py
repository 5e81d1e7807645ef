"""Campaigns: the runs of cases, what a requirement comes to on them, and what faults did."""
