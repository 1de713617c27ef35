"""Frozen records that stages hand to each other, and the protocols between stages."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
