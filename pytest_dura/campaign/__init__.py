"""Campaigns: the runs of cases, what a requirement comes to on them, and what faults did."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
