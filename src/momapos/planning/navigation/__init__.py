"""Navigation of the base: cost map, path planning, and closed-loop driving."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
