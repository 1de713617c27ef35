from .joint_belief import plan_by_hypothesis as plan_by_hypothesis
from .joint_belief import save_learned as save_learned
from .run import NO_NOISE as NO_NOISE
from .run import run_plan as run_plan
from .scan import scan_to_scene as scan_to_scene
from .solve import ScanAnswer as ScanAnswer
from .solve import ScanTask as ScanTask
from .solve import solve_scan as solve_scan
