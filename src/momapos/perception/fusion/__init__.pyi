from .completion import complete as complete
from .free_space import SeenThrough as SeenThrough
from .gravity import align_to_gravity as align_to_gravity
from .registration import register as register
from .tsdf import FusionConfig as FusionConfig
from .tsdf import fuse as fuse
