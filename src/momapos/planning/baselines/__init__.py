"""Other methods of choosing base poses, judged by the same checks as ours."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
