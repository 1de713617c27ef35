"""From a scene, a robot and a task to a plan; `plan.py` reads like Figure 1 of the paper."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
