"""Qualification of a suite: what it catches of defects that are seeded into what it rests on."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
