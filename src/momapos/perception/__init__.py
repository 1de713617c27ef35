"""From a scan to a scene with joints; `pipeline.py` calls one stage after the other."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
