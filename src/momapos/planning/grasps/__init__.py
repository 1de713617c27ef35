"""Turn a task into grasps, and each grasp into tool poses along the motion."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
