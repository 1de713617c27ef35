from .depth_sensor import DepthSensor as DepthSensor
from .recording import refuse_used as refuse_used
from .recording import synthetic_scan as synthetic_scan
from .recording import write_scan as write_scan
