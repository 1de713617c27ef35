"""From a task to grasps, and from a grasp to tool poses over the motion: waypoints."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
