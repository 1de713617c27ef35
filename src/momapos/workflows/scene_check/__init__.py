"""Check a scene before a task: what is wrong in the file, and what is known about its parts."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
