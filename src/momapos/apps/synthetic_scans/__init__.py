"""Renders scans of scenes that are known: to try the stages with, and to measure them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
