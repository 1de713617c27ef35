"""Mobile manipulators: the robot record, robot files and the library robots."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
