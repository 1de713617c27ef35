"""2-D detection of objects in color images, and votes of all images on each object's label."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
