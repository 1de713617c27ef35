"""Robots, scenes and plans, with their kinematics and collision kernels."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
