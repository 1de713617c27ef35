from .exact_check import PlanVerifier as PlanVerifier
from .floor_contact import meets_floor_at as meets_floor_at
from .plan_check import find_file as find_file
from .plan_check import read_scene as read_scene
from .plan_check import verify_files as verify_files
from .report import report_lines as report_lines
from .report import report_to_dict as report_to_dict
from .tour_check import verify_tour as verify_tour
