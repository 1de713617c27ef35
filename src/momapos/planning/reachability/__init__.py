"""How well the arm reaches a tool pose from a base pose: a map per robot, built once."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
