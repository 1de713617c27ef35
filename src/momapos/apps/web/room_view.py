"""The room on the page: floor, walls that hide nothing, furniture whose doors move."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from viser.transforms import SO3

from momapos.apps.plots import (
    BAD,
    FLOOR,
    FURNITURE,
    FURNITURE_EDGE,
    PART,
    TARGET,
    TARGET_EDGE,
    WALL,
    room_bounds,
)
from momapos.core.geometry import invert, signed_area
from momapos.model.scene import Scene, SceneObject

from .bodies import Surface, facing, joined, looks, standing
from .crowd import Crowd, Part

if TYPE_CHECKING:
    from jaxtyping import Float
    from viser import SceneApi

ROOT = "/room"
_FLOOR = " floor"
"""No object is called so."""
MOST_NODES = 200
"""A room of more objects is drawn as a crowd; else each is marked when the mouse is on it [-]."""
MOST_OF_ONE = 500
"""In a large room, a thing of more triangles is drawn as its hulls, or as a box about it [-]."""
BEYOND = 1.0
"""The floor of a room without an outline goes on for so long beyond its things [m]."""
SMALL_THING = 0.02
"""Things of less than this are set off by their color: cups, fruit [m^3]."""
THING = "#c8b28a"
SWELL = 0.004
"""What is marked is drawn so much larger than it is [m]."""

Color = tuple[int, int, int]


def rgb(color: str) -> Color:
    """A color "#rrggbb" as three numbers up to 255."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def place(handle: Any, T: Float[np.ndarray, "4 4"]) -> None:
    """Put a node where a transform says."""
    handle.position = T[:3, 3]
    handle.wxyz = SO3.from_matrix(T[:3, :3]).wxyz


def swollen(surface: Surface, by: float) -> Surface:
    """A surface moved outwards, away from its middle [m]."""
    low, high = surface.vertices.min(0), surface.vertices.max(0)
    grown = (high - low + 2 * by) / np.maximum(high - low, 1e-6)
    middle = (low + high) / 2
    return Surface(middle + (surface.vertices - middle) * grown, surface.faces)


class RoomView:
    """Draws a scene; of what does not change nothing is sent again."""

    def __init__(
        self, api: SceneApi, picked: Callable[[str], None] | None = None, *, name: str = ROOT
    ) -> None:
        """Draw nothing yet.

        Args:
            api: Where to draw.
            picked: Is told the name of an object that is clicked.
            name: Of the node from which all others hang.
        """
        self._api, self._picked, self.name = api, picked, name
        self._crowd = Crowd(api, f"{name}/crowd", picked)
        self._standing: dict[str, list[Part]] = {}
        """In a large room, the objects as the crowd draws them."""
        self._nodes: dict[str, list[Any]] = {}
        """The nodes of objects that are drawn by themselves."""
        self._drawn = 0
        self._links: dict[str, Any] = {}
        self._marks: list[Any] = []
        self._marked: set[tuple[str, str]] = set()
        """Labels and colors of what is marked."""
        self._moved: dict[str, float] = {}
        self._carried: np.ndarray | None = None
        self._collision = False
        self._root: Any = None
        self.scene: Scene | None = None
        self.active = ""
        """The object whose parts may move."""

    def set_visible(self, visible: bool) -> None:
        """Show all of the room, or nothing of it."""
        if self._root is None:
            self._root = self._api.add_frame(self.name, show_axes=False)
        self._root.visible = visible

    def remove(self) -> None:
        """Draw it no more."""
        self.mark(())
        for name in [*self._nodes]:
            self._remove(name)
        self._crowd.show(())
        self.scene, self.active, self._links = None, "", {}
        if self._root is not None:
            self._root.remove()
            self._root = None

    def carry(self, T_world_root: Float[np.ndarray, "4 4"]) -> None:
        """Move the active object, which is loose, as a whole: the pose of its root link."""
        if self.scene is None or not self.active:
            return
        self._carried = T_world_root
        item = self.scene.object(self.active)
        T = T_world_root @ invert(item.link_poses()[item.model.urdf.root])
        for node in self._nodes[self.active]:
            place(node, T)

    def rest(self) -> None:
        """Put the active object back to where the scene has it."""
        if self.scene is None or not self.active:
            return
        item = self.scene.object(self.active)
        if item.model.joints:
            self.move({})
        else:
            self.carry(item.link_poses()[item.model.urdf.root])

    def show(self, scene: Scene, active: str = "", *, collision: bool | None = None) -> None:
        """Draw a scene instead of the last; what is the same in both is not drawn again.

        Args:
            scene: The room.
            active: The object whose parts may move; it is set off by its color.
            collision: Whether to draw the hulls that are checked instead of what things look like;
                None: as before.
        """
        collision = self._collision if collision is None else collision
        same_look, same_active = self._collision == collision, self.active == active
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
        self.scene, self.active, self._collision = scene, active, collision
        self.mark(())
        if active in changed or not same_active:
            self._links = {}
        for item in scene.objects:
            if item.name in changed:
                self._draw(item)
        parts = [one for item in scene.objects for one in self._standing.get(item.name, ())]
        self._crowd.show(parts, left_out=active)
        if still:
            self._as_it_was()
        else:
            self._moved, self._carried = {}, None

    def _as_it_was(self) -> None:
        """Put the active object to where it was moved before it was drawn anew."""
        if self._carried is not None:
            self.carry(self._carried)
        self.move(self._moved)

    def move(self, values: Mapping[str, float]) -> None:
        """Move joints of the active object [rad] or [m]; all others are as the scene has them."""
        if self.scene is None or not self.active:
            return
        self._moved = dict(values)
        poses = self.scene.object(self.active).link_poses(values)
        for key, handle in self._links.items():
            place(handle, poses[key.rpartition("|")[0]])

    def mark(self, labels: Collection[str], color: str = BAD) -> None:
        """Mark what labels "object/link" name, and nothing else."""
        wanted = {(label, color) for label in labels}
        if wanted == self._marked:
            return
        self._marked = wanted
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
            surfaces = [
                joined((look.body, look.handle)).moved(poses[look.link])
                for look in looks(item.model, collision=True)
                if look.link == link or link not in poses
            ]
            for surface in surfaces:
                name = f"{self.name}/mark{len(self._marks)}"
                self._marks.append(
                    self._mesh(name, swollen(surface, SWELL), rgb(color), opacity=0.75)
                )

    # ------------------------------------------------------------------------------------ parts

    def _remove(self, name: str) -> None:
        for node in self._nodes.pop(name, []):
            node.remove()
        self._standing.pop(name, None)

    def _draw_floor(self, scene: Scene) -> None:
        polygon = scene.floor_polygon
        if polygon is None:
            low, high = room_bounds(scene) + np.array([[-BEYOND], [BEYOND]])
            polygon = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
        corners = np.column_stack([polygon, np.full(len(polygon), -0.002)])
        surface = Surface(corners, triangulated(polygon))
        floor = self._mesh(f"{self.name}/floor", surface, rgb(FLOOR), shaded=not large(scene))
        self._nodes[_FLOOR] = [floor]

    def _draw(self, item: SceneObject) -> None:
        """Draw an object; what was drawn of it is gone."""
        assert self.scene is not None
        self._drawn += 1
        root, active = f"{self.name}/o{self._drawn}", item.name == self.active
        self._nodes[item.name] = []
        if large(self.scene):
            self._standing[item.name] = self._one_of_many(item)
            if not active:
                return
        if active and item.model.joints:
            self._draw_links(item, root)
        else:
            parts = self._parts(item, active=active, collision=self._collision)
            self._nodes[item.name] = [
                self._mesh(f"{root}/p{k}", part.surface, part.color) for k, part in enumerate(parts)
            ]
        for node in self._nodes[item.name]:
            self._listen(node, item.name)

    def _draw_links(self, item: SceneObject, root: str) -> None:
        """Draw each link as a node that can be moved."""
        poses, moving = item.link_poses(), _moving(item)
        color, dark = _colors(item, active=True)
        for k, look in enumerate(looks(item.model, collision=self._collision)):
            body = PART if look.link in moving else color
            for part, surface, own in (("body", look.body, body), ("h", look.handle, dark)):
                if len(surface.faces):
                    node = self._mesh(f"{root}/l{k}{part}", surface, rgb(own))
                    place(node, poses[look.link])
                    self._links[f"{look.link}|{part}"] = node
                    self._nodes[item.name].append(node)

    def _one_of_many(self, item: SceneObject) -> list[Part]:
        """An object by the finest of its looks that has few triangles."""
        for collision in (self._collision, True):
            parts = self._parts(item, active=False, collision=collision)
            if self._collision or sum(len(one.surface.faces) for one in parts) <= MOST_OF_ONE:
                return parts
        return self._parts(item.box_proxy, active=False, collision=False)

    def _parts(self, item: SceneObject, *, active: bool, collision: bool) -> list[Part]:
        """An object as it stands, of a wall those sides that look into the room."""
        body = standing(item, lambda look: look.body, collision=collision)
        handles = standing(item, lambda look: look.handle, collision=collision)
        if item.category == "wall" and self.scene is not None:
            middle = room_bounds(self.scene).mean(0)
            body = facing(body, np.append(middle, 1.0))
        both = zip((body, handles), _colors(item, active=active), strict=True)
        return [Part(item.name, one, rgb(color)) for one, color in both if len(one.faces)]

    def _listen(self, node: Any, name: str) -> None:
        picked = self._picked
        if picked is not None:
            node.on_click(lambda _: picked(name))

    def _mesh(
        self, name: str, surface: Surface, color: Color, *, opacity: float | None = None,
        shaded: bool = True,
    ) -> Any:  # fmt: skip
        """Draw triangles; where they are shaded, shadows are seen on them."""
        return self._api.add_mesh_simple(
            name, surface.vertices.astype(np.float32), surface.faces.astype(np.uint32),
            color=color, flat_shading=True, opacity=opacity, cast_shadow=opacity is None,
            receive_shadow=shaded,
        )  # fmt: skip


def large(scene: Scene) -> bool:
    """Whether a room has so many things that it is drawn as a crowd."""
    return len(scene.objects) > MOST_NODES


def _moving(item: SceneObject) -> set[str]:
    return {link for joint in item.model.joints for link in item.model.moved_by(joint)}


def _colors(item: SceneObject, *, active: bool) -> tuple[str, str]:
    """Of the body of an object, and of its handles."""
    if active:  # of a loose thing all moves
        return (TARGET if item.model.joints else PART), TARGET_EDGE
    if item.category == "wall":
        return WALL, WALL
    small = np.prod(np.ptp(item.bounds, axis=0)) < SMALL_THING
    return (THING if small else FURNITURE), FURNITURE_EDGE


def triangulated(polygon: Float[np.ndarray, "k 2"]) -> np.ndarray:
    """Triangles of a simple polygon, counterclockwise, by cutting ears off."""
    left, triangles = list(range(len(polygon))), []
    if signed_area(polygon) < 0:
        left.reverse()
    while len(left) > 3:
        for k in range(len(left)):
            i, j, m = left[k - 1], left[k], left[(k + 1) % len(left)]
            a, b, c = polygon[i], polygon[j], polygon[m]
            others = polygon[[n for n in left if n not in (i, j, m)]]
            if _turn(a, b, c) > 0 and not _inside(others, a, b, c).any():
                triangles.append((i, j, m))
                left.pop(k)
                break
        else:  # nothing can be cut off: corners in one line
            break
    triangles.append((left[0], left[1], left[2]))
    return np.array(triangles)


def _turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> Any:
    return (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (
        c[..., 0] - a[..., 0]
    )


def _inside(points: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    inside = np.ones(len(points), bool)
    for p, q in ((a, b), (b, c), (c, a)):
        inside &= np.asarray(_turn(p, q, points)) >= 0
    return inside
