"""momapos: where must this mobile manipulator stand, and how does it move, to do that?

The public names stand in `__init__.pyi`; each is loaded when it is first used, so that
`import momapos` is quick.
"""

import lazy_loader

__version__ = "0.1.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
