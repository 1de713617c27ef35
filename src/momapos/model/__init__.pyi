from .time_law import Trajectory as Trajectory
from .trajectory import DEFAULT as DEFAULT
from .trajectory import SpeedConfig as SpeedConfig
from .trajectory import TimedTrajectory as TimedTrajectory
from .trajectory import time_motion as time_motion
from .trajectory import time_path as time_path
from .trajectory import time_plan as time_plan
from .trajectory import with_times as with_times
