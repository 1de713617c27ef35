"""Drawing the room: floor, walls that hide nothing, furniture whose doors move."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from viser.transforms import SO3

from momapos.apps import plots
from momapos.core.geometry import invert, triangulated
from momapos.model.scene import Scene, SceneObject

from . import colors
from .bodies import Surface, facing, joined, link_surfaces, world_surface
from .colors import Color, rgb
from .crowd import ColoredSurface, ObjectBatches
from .looks import HANDLE, LIGHT, Look, material

if TYPE_CHECKING:
    from jaxtyping import Float
    from viser import SceneApi

ROOT = "/room"
_FLOOR = " floor"
"""Key of the floor; no object has this name."""
MAX_SEPARATE_OBJECTS = 200
"""Rooms with more objects share nodes between them; in others an object is highlighted under the
mouse [-]."""
MAX_TRIANGLES = 500
"""In a large room, an object with more triangles is drawn as its hulls, or as its box [-]."""
FLOOR_MARGIN = 1.0
"""Margin of the floor around the objects of a room without an outline [m]."""
MARK_MARGIN = 0.004
"""A marked shape is drawn larger by this on each side [m]."""


def place(handle: Any, T: Float[np.ndarray, "4 4"]) -> None:
    """Set the pose of a node."""
    handle.position = T[:3, 3]
    handle.wxyz = SO3.from_matrix(T[:3, :3]).wxyz


def enlarged(surface: Surface, by: float) -> Surface:
    """Scale a surface about its middle, so that each side moves outward by a length [m]."""
    low, high = surface.vertices.min(0), surface.vertices.max(0)
    grown = (high - low + 2 * by) / np.maximum(high - low, 1e-6)
    middle = (low + high) / 2
    return Surface(middle + (surface.vertices - middle) * grown, surface.faces)


class RoomView:
    """Draws a scene, and sends only changes."""

    def __init__(self, api: SceneApi, picked: Callable[[str], None] | None = None) -> None:
        """Draw nothing yet.

        Args:
            api: Where to draw.
            picked: Called with the name of an object that a user clicks.
        """
        self._api, self._picked = api, picked
        self._batches = ObjectBatches(api, f"{ROOT}/batch", picked)
        self._batched: dict[str, list[ColoredSurface]] = {}
        """In a large room, the surfaces of each object in the batches."""
        self._nodes: dict[str, list[Any]] = {}
        """The nodes of objects that have their own."""
        self._drawn = 0
        self._links: dict[str, Any] = {}
        self._marks: list[Any] = []
        self._marked: set[str] = set()
        """Labels of the marked links."""
        self._moved: dict[str, float] = {}
        self._carried: np.ndarray | None = None
        self._collision = False
        self._look = LIGHT
        self._root: Any = None
        self.scene: Scene | None = None
        self.active = ""
        """The object that may move."""
        self.joint: str | None = None
        """Its joint that the task moves; None for all of them."""

    def set_visible(self, visible: bool) -> None:
        """Show or hide the room."""
        if self._root is None:
            self._root = self._api.add_frame(ROOT, show_axes=False)
        self._root.visible = visible

    def set_look(self, look: Look) -> None:
        """Draw floor and walls in the colors of a look."""
        if look is self._look:
            return
        self._look = look
        for node in self._nodes.get(_FLOOR, ()):
            node.color = rgb(look.floor)
        walls = {o.name for o in self.scene.objects if o.category == "wall"} if self.scene else ()
        for name in walls:
            for node in self._nodes.get(name, ()):
                node.color = rgb(look.wall)

    def remove(self) -> None:
        """Remove the room."""
        self.mark(())
        for name in [*self._nodes]:
            self._remove(name)
        self._batches.show(())
        self.scene, self.active, self.joint, self._links = None, "", None, {}
        if self._root is not None:
            self._root.remove()
            self._root = None

    def carry(self, T_world_root: Float[np.ndarray, "4 4"]) -> None:
        """Move the active object, which has no joints, by the pose of its root link."""
        if self.scene is None or not self.active:
            return
        self._carried = T_world_root
        item = self.scene.object(self.active)
        T = T_world_root @ invert(item.link_poses()[item.model.urdf.root])
        for node in self._nodes[self.active]:
            place(node, T)

    def rest(self) -> None:
        """Reset the active object to its pose in the scene."""
        if self.scene is None or not self.active:
            return
        item = self.scene.object(self.active)
        if item.model.joints:
            self.move({})
        else:
            self.carry(item.link_poses()[item.model.urdf.root])

    def show(
        self, scene: Scene, active: str = "", joint: str | None = None,
        *, collision: bool | None = None,
    ) -> None:  # fmt: skip
        """Draw a scene in place of the last one; equal objects are not drawn again.

        Args:
            scene: The room.
            active: The object that may move; it gets another color.
            joint: Its joint whose part gets the color of the moving part; None for all of them.
            collision: Whether to draw collision hulls in place of visuals; None for no change.
        """
        collision = self._collision if collision is None else collision
        same_look = self._collision == collision
        same_active = (self.active, self.joint) == (active, joint)
        if self.scene is scene and same_look and same_active:
            return
        alike = same_look and self.scene is not None and large(self.scene) == large(scene)
        before = {o.name: o for o in self.scene.objects} if self.scene and alike else {}
        names = {item.name for item in scene.objects}
        changed = {item.name for item in scene.objects if before.get(item.name) is not item}
        changed |= set() if same_active else {self.active, active} & names
        still = same_active and (not same_look or active not in changed)
        if self.scene is not scene:
            self._remove(_FLOOR)
            self._draw_floor(scene)
        for name in [*self._nodes]:
            if name != _FLOOR and (name in changed or name not in names):
                self._remove(name)
        self.scene, self.active, self.joint, self._collision = scene, active, joint, collision
        self.mark(())
        if active in changed or not same_active:
            self._links = {}
        for item in scene.objects:
            if item.name in changed:
                self._draw(item)
        parts = [one for item in scene.objects for one in self._batched.get(item.name, ())]
        self._batches.show(parts, left_out=active)
        if not still:
            self._moved, self._carried = {}, None
            return
        if self._carried is not None:  # the active object keeps its pose when it is redrawn
            self.carry(self._carried)
        self.move(self._moved)

    def move(self, values: Mapping[str, float]) -> None:
        """Move joints of the active object [rad] or [m]; other joints get the scene's value."""
        if self.scene is None or not self.active:
            return
        self._moved = dict(values)
        poses = self.scene.object(self.active).link_poses(values)
        for key, handle in self._links.items():
            place(handle, poses[key.rpartition("|")[0]])

    def mark(self, labels: Collection[str]) -> None:
        """Mark the links with labels "object/link", and no others."""
        if set(labels) == self._marked:
            return
        self._marked = set(labels)
        for node in self._marks:
            node.remove()
        self._marks = []
        if self.scene is None:
            return
        for name, _, link in (label.partition("/") for label in labels):
            item = next((o for o in self.scene.objects if o.name == name), None)
            if item is None:
                continue
            poses = item.link_poses()
            for own in link_surfaces(item.model, collision=True):
                if own.link == link or link not in poses:
                    surface = joined((own.body, own.handle)).moved(poses[own.link])
                    self._marks.append(self._mesh(
                        f"{ROOT}/mark{len(self._marks)}", enlarged(surface, MARK_MARGIN),
                        rgb(colors.INFEASIBLE), opacity=0.75,
                    ))  # fmt: skip

    # ------------------------------------------------------------------------------------ parts

    def _remove(self, name: str) -> None:
        for node in self._nodes.pop(name, []):
            node.remove()
        self._batched.pop(name, None)

    def _draw_floor(self, scene: Scene) -> None:
        polygon = scene.floor_polygon
        if polygon is None:
            low, high = plots.room_bounds(scene) + np.array([[-FLOOR_MARGIN], [FLOOR_MARGIN]])
            polygon = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
        corners = np.column_stack([polygon, np.full(len(polygon), -0.002)])
        surface = Surface(corners, triangulated(polygon))
        floor = self._mesh(f"{ROOT}/floor", surface, rgb(self._look.floor), shaded=not large(scene))
        self._nodes[_FLOOR] = [floor]

    def _draw(self, item: SceneObject) -> None:
        assert self.scene is not None
        self._drawn += 1
        root, active = f"{ROOT}/o{self._drawn}", item.name == self.active
        self._nodes[item.name] = []
        if large(self.scene):
            self._batched[item.name] = self._simple_parts(item)
            if not active:
                return
        if active and item.model.joints:
            self._draw_links(item, root)
        else:
            parts = self._parts(item, active=active, collision=self._collision)
            self._nodes[item.name] = [
                self._mesh(f"{root}/p{k}", one.surface, one.color, shaded=item.category == "wall")
                for k, one in enumerate(parts)
            ]
        if item.category != "wall":  # it would catch clicks even where it is not drawn
            for node in self._nodes[item.name]:
                self._listen(node, item.name)

    def _draw_links(self, item: SceneObject, root: str) -> None:
        poses, moving = item.link_poses(), _moving(item, self.joint)
        color, dark = _colors(item, self._look, active=True)
        for k, link in enumerate(link_surfaces(item.model, collision=self._collision)):
            body = colors.PART if link.link in moving else color
            for part, surface, own in (("body", link.body, body), ("h", link.handle, dark)):
                if len(surface.faces):
                    node = self._mesh(f"{root}/l{k}{part}", surface, rgb(own))
                    place(node, poses[link.link])
                    self._links[f"{link.link}|{part}"] = node
                    self._nodes[item.name].append(node)

    def _simple_parts(self, item: SceneObject) -> list[ColoredSurface]:
        """Return the most detailed surfaces of an object that have few triangles."""
        for collision in (self._collision, True):
            parts = self._parts(item, active=False, collision=collision)
            if self._collision or sum(len(one.surface.faces) for one in parts) <= MAX_TRIANGLES:
                return parts
        return self._parts(item.box_proxy, active=False, collision=False)

    def _parts(self, item: SceneObject, *, active: bool, collision: bool) -> list[ColoredSurface]:
        """Return the surfaces of an object; of a wall only those that face the room."""
        body = world_surface(item, lambda link: link.body, collision=collision)
        handles = world_surface(item, lambda link: link.handle, collision=collision)
        if item.category == "wall" and self.scene is not None:
            middle = plots.room_bounds(self.scene).mean(0)
            body = facing(body, np.append(middle, 1.0))
        both = zip((body, handles), _colors(item, self._look, active=active), strict=True)
        return [ColoredSurface(item.name, one, rgb(color)) for one, color in both if len(one.faces)]

    def _listen(self, node: Any, name: str) -> None:
        picked = self._picked
        if picked is not None:
            node.on_click(lambda _: picked(name))

    def _mesh(
        self, name: str, surface: Surface, color: Color, *, opacity: float | None = None,
        shaded: bool = False,
    ) -> Any:  # fmt: skip
        """Draw a surface; `shaded` ones receive shadows, which give others stripes."""
        return self._api.add_mesh_simple(
            name, *surface.arrays, color=color, flat_shading=True, opacity=opacity,
            cast_shadow=opacity is None, receive_shadow=shaded,
        )  # fmt: skip


def large(scene: Scene) -> bool:
    """Return whether a room has so many objects that they share nodes."""
    return len(scene.objects) > MAX_SEPARATE_OBJECTS


def _moving(item: SceneObject, joint: str | None) -> set[str]:
    """Return the links that a joint moves, or its leader; all that move for no joint."""
    if joint is None:
        return {link for name in item.model.joints for link in item.model.moved_by(name)}
    mimic = item.joint(joint).mimic
    return set(item.model.moved_by(joint if mimic is None else mimic.joint))


def _colors(item: SceneObject, look: Look, *, active: bool) -> tuple[str, str]:
    """Return the colors of an object and of its handles."""
    if active:  # an object without joints moves as a whole
        return (colors.TARGET if item.model.joints else colors.PART), HANDLE
    if item.category == "wall":
        return look.wall, look.wall
    return material(item), HANDLE
