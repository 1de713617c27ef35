from .opened import Opened as Opened
from .opened import OpenedScan as OpenedScan
from .robot_page import served_robot as served_robot
from .serve import LOOPBACK as LOOPBACK
from .serve import served as served
from .static import write_page as write_page
from .static import write_study_page as write_study_page
