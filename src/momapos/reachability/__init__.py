"""How well the arm reaches a tool pose from a base pose: a map per robot, built once."""

from momapos.reachability.construct import build_map, default_config
from momapos.reachability.evaluation import ReachEvaluation, evaluate
from momapos.reachability.map import ReachConfig, ReachMap
from momapos.reachability.store import load_reach_map

__all__ = [
    "ReachConfig",
    "ReachEvaluation",
    "ReachMap",
    "build_map",
    "default_config",
    "evaluate",
    "load_reach_map",
]
