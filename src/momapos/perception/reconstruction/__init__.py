"""Reconstruct how the important objects move, from images of their fronts."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
