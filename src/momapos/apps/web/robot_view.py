"""Drawing the robot: a base that can be dragged, arm, footprint and collision spheres."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any

import numpy as np
from viser.transforms import SO3

from momapos.apps.plots import sphere_centers
from momapos.core.geometry import invert, pose_planar, triangulated
from momapos.model.robots import Robot

from .colors import FORCE, INFEASIBLE, SPHERES, VERDICTS, Color, rgb
from .room_view import joined, link_surfaces, place

if TYPE_CHECKING:
    from jaxtyping import Float
    from viser import SceneApi

BODY, ARM, HAND = "#aeb9c3", "#3d4c5a", "#20272e"
"""Materials of base, arm and hand; no codes."""
ARROW_PER_NEWTON, MAX_ARROW, MIN_FORCE = 0.03, 0.6, 1.0
"""Length of a force arrow [m/N], its maximum length [m], and the smallest force drawn [N]."""
ARROW_HEIGHT = 0.15
"""Height of the arrow above the hand, as the arm often lies along the force [m]."""
FOOTPRINT_HEIGHT = 0.006
"""Height of the footprint above the floor [m]."""


def home_values(robot: Robot) -> dict[str, float]:
    """Return the arm's joint values in its home configuration, by name [rad] or [m]."""
    return joint_values(robot, robot.chain.joint_values(robot.home))


def joint_values(robot: Robot, q: Float[np.ndarray, " m"]) -> dict[str, float]:
    """Return a plan's joint values by name [rad] or [m]."""
    return dict(zip(robot.moved_joints, q.tolist(), strict=True))


def tool_pose(
    robot: Robot, base: Float[np.ndarray, "3"], values: dict[str, float]
) -> Float[np.ndarray, "4 4"]:
    """Return the tool's pose in the world.

    Args:
        robot: The robot.
        base: x [m], y [m], yaw [rad].
        values: Joint values by name [rad] or [m].
    """
    poses = robot.model.link_poses(values)
    T_base_tool = invert(poses[robot.base_link]) @ poses[robot.tool_link]
    return pose_planar(base) @ T_base_tool


class RobotView:
    """Draws a robot at a base pose. The drag handle is the parent node of all others."""

    def __init__(
        self, api: SceneApi, name: str = "/robot", *, dragged: Callable[[Any], None] | None = None
    ) -> None:
        """Draw nothing yet.

        Args:
            api: Where to draw.
            name: Name of the node.
            dragged: Called when a user drags the base; None for a base without a handle.
        """
        self._api, self.name, self._dragged = api, name, dragged
        self.robot: Robot | None = None
        self.base = np.zeros(3)
        self._values: dict[str, float] = {}
        self._links: list[tuple[str, Any]] = []
        self._colors: dict[str, Color] = {}
        """Of each link, unless it is marked."""
        self._frame: Any = None
        self._spheres: Any = None
        self._force: Any = None
        self._verdict = ""
        self._spheres_shown = False

    def show(self, robot: Robot, base: Float[np.ndarray, "3"], *, opacity: float | None = None,
             color: str | None = None, collision: bool = False) -> None:  # fmt: skip
        """Draw a robot with its arm at home, in place of the last one.

        Args:
            robot: The robot.
            base: x [m], y [m], yaw [rad].
            opacity: Opacity; None for a solid robot.
            color: One color for all links; None for the usual ones.
            collision: Whether to draw collision shapes in place of visuals.
        """
        if self._frame is not None:
            self._frame.remove()
        self.robot, self._links, self._spheres = robot, [], None
        if self._dragged is not None:
            self._frame = self._api.add_transform_controls(
                self.name, scale=0.75, line_width=3.5, active_axes=(True, True, False),
                depth_test=False, opacity=0.85,
            )  # fmt: skip
            self._frame.on_update(self._dragged)
        else:
            self._frame = self._api.add_frame(self.name, show_axes=False)
        hand = set(robot.gripper_links)
        arm = {link for link, segment in robot.segments.of_link.items() if segment > 0}
        for k, link in enumerate(link_surfaces(robot.model, collision=collision)):
            own = rgb(color or (HAND if link.link in hand else ARM if link.link in arm else BODY))
            surface = joined((link.body, link.handle))
            node = self._api.add_mesh_simple(
                f"{self.name}/l{k}", *surface.arrays, color=own, flat_shading=True,
                opacity=opacity, cast_shadow=opacity is None, receive_shadow=False,
            )  # fmt: skip
            self._links.append((link.link, node))
            self._colors[link.link] = own
        self._draw_footprint()
        self._values = {}
        self.move(base, home_values(robot))

    def remove(self) -> None:
        """Remove the robot."""
        if self._frame is not None:
            self._frame.remove()
        if self._force is not None:
            self._force.remove()
        self._frame, self._force, self.robot, self._links = None, None, None, []

    def move(
        self,
        base: Float[np.ndarray, "3"] | None = None,
        values: dict[str, float] | None = None,
    ) -> None:
        """Move the base, the joints, or both.

        Args:
            base: x [m], y [m], yaw [rad].
            values: Joint values by name [rad] or [m]; other joints are at rest.
        """
        if self.robot is None:
            return
        if base is not None:
            self.base = np.asarray(base, float)
            self._frame.position = np.array([base[0], base[1], 0.0])
            self._frame.wxyz = SO3.from_z_radians(base[2]).wxyz
        if values is not None and values != self._values:
            self._values = values
            poses = self.robot.model.link_poses(values)
            T_base_root = invert(poses[self.robot.base_link])
            for link, node in self._links:
                place(node, T_base_root @ poses[link])
            if self._spheres_shown:
                self._draw_spheres()

    def mark(self, links: Collection[str]) -> None:
        """Draw some links in red, and no others."""
        for link, node in self._links:
            color = rgb(INFEASIBLE) if link in links else self._colors[link]
            if tuple(node.color) != color:
                node.color = color

    def show_force(self, force: Float[np.ndarray, "3"] | None) -> None:
        """Draw an arrow for the force that the hand exerts, opposite to the one on the hand [N]."""
        size = 0.0 if force is None else float(np.linalg.norm(force))
        if self.robot is None or force is None or size < MIN_FORCE:
            if self._force is not None:
                self._force.visible = False
            return
        hand = tool_pose(self.robot, self.base, self._values)[:3, 3] + [0.0, 0.0, ARROW_HEIGHT]
        arrow = np.stack([hand, hand - force * min(ARROW_PER_NEWTON, MAX_ARROW / size)])[None]
        if self._force is None:
            self._force = self._api.add_arrows(
                f"{self.name}_force", arrow, rgb(FORCE), shaft_radius=0.015, head_radius=0.04,
                head_length=0.09,
            )  # fmt: skip
        self._force.points = arrow.astype(np.float32)
        self._force.visible = True

    def show_handle(self, shown: bool) -> None:
        """Show or hide the handle that drags the base."""
        if self._frame is not None and self._dragged is not None:
            for part in ("axes", "sliders", "rotations"):
                setattr(self._frame, f"disable_{part}", not shown)

    def verdict(self, word: str) -> None:
        """Color the footprint: "feasible", "partly", "infeasible", or "" for unknown."""
        if word != self._verdict:
            self._verdict = word
            self._draw_footprint()

    def show_spheres(self, shown: bool) -> None:
        """Show or hide the collision spheres."""
        self._spheres_shown = shown
        if shown:
            self._draw_spheres()
        elif self._spheres is not None:
            self._spheres.remove()
            self._spheres = None

    def _draw_footprint(self) -> None:
        if self.robot is None:
            return
        xy = self.robot.footprint
        front = float(xy[:, 0].max())
        tip = np.array([[front + 0.16, 0.0], [front + 0.03, 0.07], [front + 0.03, -0.07]])
        points = np.concatenate([xy, tip])
        faces = np.concatenate([triangulated(xy), [[len(xy), len(xy) + 1, len(xy) + 2]]])
        corners = np.column_stack([points, np.full(len(points), FOOTPRINT_HEIGHT)])
        self._api.add_mesh_simple(
            f"{self.name}/footprint", corners.astype(np.float32), faces.astype(np.uint32),
            color=rgb(VERDICTS[self._verdict]), opacity=0.8, side="double", cast_shadow=False,
            receive_shadow=False,
        )  # fmt: skip

    def _draw_spheres(self) -> None:
        assert self.robot is not None
        q = np.array([self._values.get(n, 0.0) for n in self.robot.chain.joints])
        centers, _ = sphere_centers(self.robot, self.robot.chain.freedom_values(q))
        if self._spheres is not None:  # only their positions change
            self._spheres.batched_positions = centers.astype(np.float32)
            return
        import trimesh

        ball = trimesh.creation.icosphere(2, 1.0)
        turned = np.tile([1.0, 0.0, 0.0, 0.0], (len(centers), 1))
        self._spheres = self._api.add_batched_meshes_simple(
            f"{self.name}/spheres", np.asarray(ball.vertices, np.float32),
            np.asarray(ball.faces, np.uint32), turned, centers,
            batched_scales=self.robot.spheres.radius, batched_colors=rgb(SPHERES), opacity=0.45,
            cast_shadow=False,
        )  # fmt: skip
