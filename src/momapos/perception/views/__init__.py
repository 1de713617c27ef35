"""Which images show the front of a thing, and what that front looks like seen straight on."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
