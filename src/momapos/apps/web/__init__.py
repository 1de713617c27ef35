"""The web page: a room, a robot, a question and its answer, moving."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
