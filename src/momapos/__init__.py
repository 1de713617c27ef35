"""momapos: where must this mobile manipulator stand, and how does it move, to do that?

Public names are loaded when they are first used, so that `import momapos` is quick.
"""

from __future__ import annotations

import importlib
from typing import Any

_PUBLIC = {
    "Answer": "momapos.pipeline",
    "Importance": "momapos.importance.rank",
    "ImportanceConfig": "momapos.importance.config",
    "MomaposError": "momapos.errors",
    "Motion": "momapos.types",
    "PipelineConfig": "momapos.config",
    "PlacementPlan": "momapos.types",
    "Robot": "momapos.robots.robot",
    "Scene": "momapos.scene.scene",
    "SceneObject": "momapos.scene.scene",
    "Task": "momapos.types",
    "load_robot": "momapos.robots.robot",
    "load_scene": "momapos.scene.files",
    "make_task": "momapos.manipulation.tasks",
    "openable": "momapos.manipulation.tasks",
    "place": "momapos.pipeline",
    "rank": "momapos.importance.rank",
    "read_plan": "momapos.plans",
    "read_scan": "momapos.perception.scan",
    "save_scene": "momapos.scene.files",
    "scan_to_scene": "momapos.scan_pipeline",
    "verify_files": "momapos.verification.files",
    "write_plan": "momapos.plans",
}
__all__ = sorted(_PUBLIC)
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'momapos' has no attribute {name!r}")
    return getattr(importlib.import_module(_PUBLIC[name]), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
