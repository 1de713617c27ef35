"""What the color images show: detectors, their files, and votes of all images for each thing."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
