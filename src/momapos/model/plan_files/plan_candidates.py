"""Write and read the statistics of a plan's candidate base poses."""

from __future__ import annotations

from typing import Any

from momapos.model.records import Candidates, NearestMiss

from . import plan_members as members


def candidates_to_dict(candidates: Candidates) -> dict[str, Any]:
    """Return the member of a plan file; the nearest miss only if there is one."""
    found: dict[str, Any] = {
        "sampled": candidates.sampled,
        "checked": candidates.checked,
        "rejections": dict(candidates.rejections),
    }
    if candidates.nearest is not None:
        pose = dict(zip(("x", "y", "yaw"), candidates.nearest.base_pose, strict=True))
        found["nearest"] = {"base_pose": pose, "reason": candidates.nearest.reason}
    return found


def read_candidates(data: members.PlanCandidates) -> Candidates:
    """Return the record of the member of a plan file."""
    miss = data.nearest
    nearest = None
    if miss is not None:
        pose = miss.base_pose
        nearest = NearestMiss((pose.x, pose.y, pose.yaw), miss.reason)
    return Candidates(data.sampled, data.checked, data.rejections, nearest)
