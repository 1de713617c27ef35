"""Drawing the room: floor, walls that hide nothing, furniture whose doors move.

A browser draws node by node, each with a shadow. A thousand nodes of a few triangles take far
longer than a few nodes of thousands of triangles without shadows. In return, objects are not
highlighted under the mouse.

Materials are pale and have no meaning; strong colors do, see `colors`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from viser.transforms import SO3

from momapos.apps import plots
from momapos.core import UrdfError, owner_cache
from momapos.core.geometry import apply, invert, triangulated
from momapos.model.scene import Scene, SceneObject
from momapos.model.urdf import Articulated, Geometry, Hull, mesh_triangles

from . import colors
from .colors import Color, rgb

if TYPE_CHECKING:
    from jaxtyping import Float, Float32, Int, UInt8, UInt32
    from viser import SceneApi


MAX_LINK_TRIANGLES = 60_000
"""A shape with more triangles is drawn as its convex hull [-]."""
HANDLE_WORD = "handle"
"""Shapes and links with this in their names get another color."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles that are visible from their counterclockwise side."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]

    def moved(self, T: Float[np.ndarray, "4 4"]) -> Surface:
        """Transform the surface."""
        return Surface(apply(T, self.vertices), self.faces)

    @property
    def arrays(self) -> tuple[Float32[np.ndarray, "v 3"], UInt32[np.ndarray, "f 3"]]:
        """Vertices and faces in the types that viser sends."""
        return self.vertices.astype(np.float32), self.faces.astype(np.uint32)


@dataclass(frozen=True)
class LinkSurfaces:
    """The surfaces of one link."""

    link: str
    body: Surface
    handle: Surface
    """Shapes with "handle" in their names; no triangles where there is none."""


def joined(surfaces: Iterable[Surface]) -> Surface:
    """Join surfaces into one."""
    parts = [one for one in surfaces if len(one.faces)]
    if not parts:
        return Surface(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    first = np.cumsum([0, *(len(one.vertices) for one in parts[:-1])])
    faces = [one.faces + k for one, k in zip(parts, first.tolist(), strict=True)]
    return Surface(np.concatenate([one.vertices for one in parts]), np.concatenate(faces))


def _hull_surface(hull: Hull) -> Surface:
    return Surface(hull.vertices, hull.faces)


@owner_cache()
def link_surfaces(model: Articulated, *, collision: bool = False) -> tuple[LinkSurfaces, ...]:
    """Return the surfaces of a model's links, without links that have no shapes.

    Args:
        model: The model.
        collision: Whether to use the collision hulls even where there are visuals.
    """
    found = []
    for name, link in model.urdf.links.items():
        if collision or not link.visuals:
            pairs = [(hull.name or name, _hull_surface(hull)) for hull in model.hulls[name]]
        else:
            pairs = [(shape.name or name, _surface(model, name, shape)) for shape in link.visuals]
        body = joined(surface for word, surface in pairs if not _is_handle(name, word))
        handle = joined(surface for word, surface in pairs if _is_handle(name, word))
        if len(body.faces) or len(handle.faces):
            found.append(LinkSurfaces(name, body, handle))
    return tuple(found)


def _is_handle(link: str, shape: str) -> bool:
    return HANDLE_WORD in link.lower() or HANDLE_WORD in shape.lower()


def _surface(model: Articulated, link: str, shape: Geometry) -> Surface:
    """Return the surface of a shape: the triangles of a mesh if they are readable, else a hull."""
    if shape.kind == "mesh" and shape.mesh is not None:
        try:
            triangles = mesh_triangles(shape.mesh) * np.array(shape.size)
        except UrdfError:  # a mesh without readable faces still has a hull
            triangles = np.zeros((0, 3, 3))
        if 0 < len(triangles) <= MAX_LINK_TRIANGLES:
            if np.prod(shape.size) < 0:  # mirrored: inside out
                triangles = triangles[:, ::-1]
            return _merged(apply(shape.T_link_geometry, triangles.reshape(-1, 3)))
    return _hull_surface(model.hull(link, shape))


def _merged(corners: Float[np.ndarray, "c 3"]) -> Surface:
    """Build a surface from three corners per triangle, and merge equal ones.

    A browser then gets about a tenth of the vertices; shading is flat anyway.
    """
    points, at = np.unique(corners, axis=0, return_inverse=True)
    return Surface(points, at.reshape(-1, 3))


def world_surface(
    item: SceneObject, part: Callable[[LinkSurfaces], Surface], *, collision: bool = False
) -> Surface:
    """Return the bodies or the handles of all links of an object, in the world.

    Args:
        item: The object.
        part: Selects the body or the handle of a link.
        collision: As for `link_surfaces`.
    """
    poses = item.link_poses()
    links = link_surfaces(item.model, collision=collision)
    return joined(part(link).moved(poses[link.link]) for link in links)


def facing(surface: Surface, point: Float[np.ndarray, "3"]) -> Surface:
    """Select the triangles whose front faces a point.

    Walls drawn this way hide nothing of the room from outside.
    """
    a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
    front = np.einsum("fk,fk->f", np.cross(b - a, c - a), point - a) > 0
    return Surface(surface.vertices, surface.faces[front])


MAX_MERGED = 1000
"""Triangles of a node, unless one object has more; a change sends all of its node again [-]."""


@dataclass(frozen=True, eq=False)
class ColoredSurface:
    """The surface of an object in one color, in the world."""

    object: str
    surface: Surface
    color: tuple[int, int, int]

    @cached_property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Lower and upper corner [m]."""
        return np.stack([self.surface.vertices.min(0), self.surface.vertices.max(0)])


Picked: TypeAlias = "Callable[[str, Float[np.ndarray, '3'] | None], None]"
"""Called with the object that a user clicks, and where, if that is known [m]."""


class ObjectBatches:
    """Draws objects in few nodes, and sends only the nodes that change."""

    def __init__(self, api: SceneApi, name: str, picked: Picked | None = None) -> None:
        """Draw nothing yet.

        Args:
            api: Where to draw.
            name: Prefix of the nodes' names.
            picked: Called with the name of an object that a user clicks, and where [m].
        """
        self._api, self._name, self._picked = api, name, picked
        self._parts: tuple[ColoredSurface, ...] = ()
        self._left_out = ""
        self._drawn: list[tuple[list[ColoredSurface], Any]] = []
        """The surfaces of each node, and the node; None where none of them is drawn."""
        self._listens = False

    @property
    def nodes(self) -> tuple[Any, ...]:
        """The nodes that are drawn."""
        return tuple(node for _, node in self._drawn if node is not None)

    def show(self, parts: Sequence[ColoredSurface], left_out: str = "") -> None:
        """Draw surfaces in place of the last ones.

        Args:
            parts: The surfaces.
            left_out: An object that is drawn elsewhere; "" for none.
        """
        self._parts, self._left_out = tuple(parts), left_out
        batches = batched(parts)
        for _, node in self._drawn[len(batches) :]:
            if node is not None:
                node.remove()
        self._drawn = self._drawn[: len(batches)]
        for k, batch in enumerate(batches):
            wanted = [part for part in batch if part.object != left_out]
            if k == len(self._drawn):
                self._drawn.append((wanted, self._draw(k, wanted)))
            elif self._drawn[k][0] != wanted:
                if self._drawn[k][1] is not None:
                    self._drawn[k][1].remove()
                self._drawn[k] = wanted, self._draw(k, wanted)
        self._listen(bool(parts) and self._picked is not None)

    def _draw(self, k: int, parts: Sequence[ColoredSurface]) -> Any:
        if not parts:
            return None
        surface = joined(part.surface for part in parts)
        return self._api.add_mesh_simple(
            f"{self._name}{k}", *surface.arrays, color=parts[0].color, flat_shading=True,
            cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

    def _listen(self, wanted: bool) -> None:
        if wanted and not self._listens:
            self._api.on_click()(self._clicked)
        elif self._listens and not wanted:
            self._api.remove_click_callback(self._clicked)
        self._listens = wanted

    def _clicked(self, event: Any) -> None:
        hit = object_hit(self._parts, event)
        if self._picked is not None and hit is not None and hit[0] != self._left_out:
            self._picked(*hit)


def batched(parts: Sequence[ColoredSurface]) -> list[list[ColoredSurface]]:
    """Group surfaces of one color, in their order, as many as one node may hold."""
    batches: list[list[ColoredSurface]] = []
    for color in dict.fromkeys(part.color for part in parts):
        left = 0
        for part in (one for one in parts if one.color == color):
            count = len(part.surface.faces)
            if count > left:
                batches.append([])
                left = MAX_MERGED
            batches[-1].append(part)
            left -= count
    return batches


def object_hit(
    parts: Sequence[ColoredSurface], event: Any
) -> tuple[str, Float[np.ndarray, "3"]] | None:
    """Return the first object that the ray of a click hits, and where [m]; None where it hits none.

    Args:
        parts: The surfaces.
        event: The click.
    """
    origin, direction = np.array(event.ray_origin), np.array(event.ray_direction)
    if not parts:
        return None
    bounds = np.stack([part.bounds for part in parts])
    with np.errstate(divide="ignore", invalid="ignore"):
        crossed = np.sort((bounds - origin) / direction, axis=1)  # NaN along a face
    enters, leaves = np.nanmax(crossed[:, 0], axis=1), np.nanmin(crossed[:, 1], axis=1)
    near = np.flatnonzero((enters <= leaves) & (leaves >= 0.0)).tolist()
    distances = [_distance(parts[k].surface, origin, direction) for k in near]
    if not distances or min(distances) == np.inf:
        return None
    nearest = int(np.argmin(distances))
    return parts[near[nearest]].object, origin + distances[nearest] * direction


def _distance(
    surface: Surface, origin: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]
) -> float:
    """Intersect a ray with the front of a surface: distance in lengths of its direction, or inf.

    By Moeller and Trumbore: Fast, minimum storage ray-triangle intersection, 1997.
    """
    a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
    across = np.cross(direction, c - a)
    volume = np.einsum("fk,fk->f", b - a, across)
    front = volume > 1e-12
    from_a = (origin - a)[front]
    u = np.einsum("fk,fk->f", from_a, across[front]) / volume[front]
    turned = np.cross(from_a, (b - a)[front])
    v = turned @ direction / volume[front]
    t = np.einsum("fk,fk->f", turned, (c - a)[front]) / volume[front]
    hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0)
    return float(t[hit].min(initial=np.inf))


WOOD, METAL, PAINT, HANDLE = "#c8ae8e", "#c3cad1", "#e6e8ea", "#59626b"
SMALL_OBJECT = "#b99f7d"
MATERIALS = {
    WOOD: ("table", "chair", "counter", "desk", "shelf", "bench", "stool", "worktop", "bookcase"),
    METAL: ("fridge", "oven", "microwave", "dishwasher", "hood", "stove", "sink", "washer",
            "refrigerator", "cooktop", "toaster", "kettle"),
}  # fmt: skip
"""Words in the category of an object; any other is painted."""
SMALL_VOLUME = 0.02
"""Objects with a smaller bounding box are drawn like cups and fruit [m^3]."""
SKY_ROWS = 128
"""Height of the image of the sky [px]."""


@dataclass(frozen=True)
class Look:
    """Colors that depend on whether the page is dark."""

    zenith: str
    horizon: str
    ground: str
    """The sky from top to bottom."""
    floor: str
    wall: str
    sun: float
    """Intensity of the light with shadows [-]."""
    ambient: float
    """Intensity of the light from all directions [-]."""


LIGHT = Look("#bcd4ea", "#f2f6fa", "#e4e8ec", "#d3c7b5", "#f7f6f3", 1.9, 1.5)
DARK = Look("#0e141b", "#26323f", "#151b21", "#6a645c", "#59636e", 1.7, 0.9)


def sky(look: Look) -> UInt8[np.ndarray, "rows 2 3"]:
    """Return an image of the sky, whose horizon is in its middle."""
    stops = np.array([rgb(c) for c in (look.zenith, look.horizon, look.ground)], float)
    height = np.linspace(0.0, 1.0, SKY_ROWS)
    channels = [np.interp(height, [0.0, 0.55, 1.0], stops[:, k]) for k in range(3)]
    return np.repeat(np.stack(channels, -1)[:, None], 2, axis=1).round().astype(np.uint8)


def material(item: SceneObject) -> str:
    """Return the color of an object that has no part in the task."""
    if np.prod(np.ptp(item.bounds, axis=0)) < SMALL_VOLUME:
        return SMALL_OBJECT
    words = item.category.lower()
    return next(
        (color for color, kinds in MATERIALS.items() if any(kind in words for kind in kinds)), PAINT
    )


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

    def __init__(self, api: SceneApi, picked: Picked | None = None) -> None:
        """Draw nothing yet.

        Args:
            api: Where to draw.
            picked: Called with the name of an object that a user clicks, and where [m].
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
        if self._picked is not None:
            node.on_click(lambda event: self._clicked(name, event))

    def _clicked(self, name: str, event: Any) -> None:
        assert self.scene is not None
        assert self._picked is not None
        hit = object_hit(self._simple_parts(self.scene.object(name)), event)
        self._picked(name, None if hit is None else hit[1])

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
