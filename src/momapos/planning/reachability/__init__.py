"""Reachability maps: how well an arm reaches a tool pose from a base pose."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
