"""Build a scene with joints from a scan; `pipeline.py` calls the stages in order."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
