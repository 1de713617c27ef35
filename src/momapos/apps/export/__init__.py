"""Plans as other programs take them: trajectories, ROS 2 messages, recordings, planning scenes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
