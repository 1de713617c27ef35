from .bags import BagTopics as BagTopics
from .clouds import write_cloud as write_cloud
from .images import read_color as read_color
from .masks import read_instances as read_instances
from .scan_reader import UpAxis as UpAxis
from .scan_reader import read_scan as read_scan
from .validation import rigid_pose as rigid_pose
