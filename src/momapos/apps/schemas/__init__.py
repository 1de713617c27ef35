"""JSON Schemas of all files that momapos reads and writes, generated from their records."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
