"""Rooms in the formats of other programs: read into ours, and written from ours."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
