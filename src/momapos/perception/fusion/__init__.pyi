from .completion import complete as complete
from .gravity import align_to_gravity as align_to_gravity
from .tsdf import FusionConfig as FusionConfig
from .tsdf import fuse as fuse
