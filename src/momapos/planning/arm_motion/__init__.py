"""From tool poses to an arm motion: inverse kinematics, continuous paths, the approach."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
