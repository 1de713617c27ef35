"""Batched collision checks of robots (spheres and hulls) against a scene and themselves."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
