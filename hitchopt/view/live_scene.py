"""A scene in viser: drones, cables and surroundings at a moment."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.values import Array
from hitchopt.view.cables import CLASPS
from hitchopt.view.scene import SPAN, Highlight, RigidSurface, Scene, mesh, sphere_faces
from hitchopt.view.style import MARK_COLOUR, rgb

Server = Any  # A viser server; viser is an optional dependency
ARROW_SCALE = 0.2  # Length of an arrow of 1 N [m]
MAX_NAMED = 40  # Maximum number of drones with names at first: more names hide the scene
PALE_COLOUR = "#969ca2"  # Colour of a ghost
PALE_OPACITY = 0.4  # Opacity of a ghost's drones and objects
TRAIL_DURATION = 5.0  # Duration of a trail [s]
TRAIL_CORNERS = 41  # Number of corners of a trail
# Maximum number of segments of all trails, for browsers with software rendering
MAX_SEGMENTS = 4000
TRAIL_WIDTH = 1.2  # Width of a trail [pixels], since thinner ones have gaps
EDGE_WIDTH = 0.006  # Width of the arena's edges [m]
ARENA_COLOUR = "#cbcbcb"  # Colour of the arena's edges
SHELL_COLOUR = "#2a8c82"  # Colour of drones' ellipsoids
ARROWS = {"forces": "#c8414f", "thrusts": "#0b3c5d"}  # Colours of the drones' arrows

SWITCHES = ("trails", "downwash ellipsoids", "forces", "thrusts", "names")


class LiveScene:
    """A scene in the browser.

    The prefix of its names in the server's scene is ``name``, which ends in a slash. A ghost is
    drawn pale, without surroundings and switches.
    """

    def __init__(self, server: Server, scene: Scene, name: str, *, ghost: bool = False) -> None:
        self.scene = scene
        self._api = server.scene
        self._name = name
        self._ghost = ghost
        self._highlight = Highlight()
        self._time = 0.0
        self._moment = scene.at(0.0)
        few = scene.drones.shape[1] <= MAX_NAMED
        self.visible = {switch: few and switch in ("trails", "names") for switch in SWITCHES}
        colours = scene.appearance.cable_colours
        cables = _segments(self._moment.cables)
        self._cable_colours = (PALE_COLOUR,) * len(colours) if ghost else colours
        self._cables = self._lines("cables", cables, self._cable_colours, 2.0 * scene.radius)
        opacity = PALE_OPACITY if ghost else None
        pale = _as_bytes((PALE_COLOUR,))[0]
        self._drones = list[Any]()
        for part in scene.appearance.drone_parts():
            drones = pale if ghost else _as_bytes(part.colours, linear=True)
            self._drones.append(self._batch(f"drones/{part.name}", part.faces, drones, opacity))
        self._objects = [
            self._solid(f"objects/{each.name}", each, opacity) for each in scene.appearance.objects
        ]
        if not ghost:
            self._add_switched()
            self._add_surroundings()
        self._draw()

    def show(self, time: float) -> None:
        """Draw the scene at a time [s]."""
        self._time, self._moment = time, self.scene.at(time)
        self._draw()

    def switch(self, name: str, *, on: bool) -> None:
        """Show or hide trails, ellipsoids, forces, thrusts or names."""
        self.visible[name] = on
        self._draw()

    def highlight(self, parts: Highlight) -> None:
        """Highlight drones, cables and vertices."""
        self._highlight = parts
        colours = [*self._cable_colours]
        for k in self._highlight.cables:
            colours[k] = MARK_COLOUR
        if colours:
            self._cables.colors = self._per_segment(colours, len(self._cables.points))
        self._draw()

    def _draw(self) -> None:
        """Update all positions and switches."""
        moment, visible = self._moment, self.visible
        turns = moment.quaternions / np.linalg.norm(moment.quaternions, axis=-1, keepdims=True)
        for batch in self._drones:
            batch.batched_positions = _float32(moment.drones)
            batch.batched_wxyzs = _float32(turns)
        if moment.cables.size:
            self._cables.points = _segments(moment.cables)
        for solid, pose in zip(self._objects, moment.objects, strict=True):
            solid.position = pose[:3]
            solid.wxyz = pose[3:] / np.linalg.norm(pose[3:])
        if self._ghost:
            return
        self._trails.visible = visible["trails"]
        if self._trails.visible:
            self._trails.points = self._trail()
        self._shells.visible = visible["downwash ellipsoids"]
        if self._shells.visible:
            self._shells.batched_positions = _float32(moment.drones)
        for label, place in zip(self._labels, moment.drones, strict=True):
            label.visible = visible["names"]
            if label.visible:
                label.position = tuple(place)
        self._draw_arrows()
        self._draw_marks()

    def _draw_arrows(self) -> None:
        """Update the arrows of cable forces and thrusts; thrusts are along the bodies' z axes."""
        moment, visible = self._moment, self.visible
        w, x, y, z = np.moveaxis(moment.quaternions, -1, 0)
        up = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)
        vectors = {"forces": moment.cable_forces, "thrusts": moment.thrusts[:, None] * up}
        for name, vector in vectors.items():
            self._arrows[name].visible = visible[name]
            if visible[name]:
                ends = [moment.drones, moment.drones + ARROW_SCALE * vector]
                self._arrows[name].points = _float32(np.stack(ends, axis=1))

    def _draw_marks(self) -> None:
        """Update the balls at highlighted drones and vertices.

        A vertex is where the first bend of its clasp's cable is.
        """
        moment = self._moment
        clasps = self.scene.appearance.clasps
        cables = [clasp.cable for clasp in clasps if clasp.vertex in self._highlight.vertices]
        vertices = moment.cables[cables, CLASPS[0]]
        balls = np.concatenate([moment.drones[list(self._highlight.drones)], vertices])
        self._marks.visible = len(balls) > 0
        if len(balls):
            self._marks.batched_positions = _float32(balls)
            self._marks.batched_wxyzs = _identities(len(balls))

    def _add_switched(self) -> None:
        """Add the parts with switches, and the highlighting balls."""
        look, drones = self.scene.appearance, self._moment.drones
        shell_colour, mark_colour = _as_bytes((SHELL_COLOUR, MARK_COLOUR))
        self._shells = self._batch("ellipsoids", sphere_faces(look.ellipsoid), shell_colour, 0.15)
        ball = sphere_faces(1.5 * SPAN * look.ellipsoid[0])
        self._marks = self._batch("marks", ball, mark_colour, 0.5, count=1)
        points = np.repeat(drones[:, None], 2, axis=1)
        self._arrows = {
            kind: self._lines(kind, points, (colour,)) for kind, colour in ARROWS.items()
        }
        pale = 0.5 * rgb(look.drone_colours) + 0.47
        colours = [f"#{bytes(each).hex()}" for each in np.rint(255.0 * pale).astype(np.uint8)]
        self._trails = self._lines("trails", self._trail(), colours, TRAIL_WIDTH, "screen")
        self._labels = [
            self._api.add_label(f"{self._name}names/{drone}", drone, position=tuple(place))
            for drone, place in zip(look.drones, drones, strict=True)
        ]

    def _trail(self) -> NDArray[np.float32]:
        """Return the segments of all drones' trails at the current time."""
        count = min(TRAIL_CORNERS, max(2, MAX_SEGMENTS // self.scene.drones.shape[1]))
        times = np.maximum(np.linspace(self._time - TRAIL_DURATION, self._time, count), 0.0)
        corners = self.scene.drones[np.searchsorted(self.scene.t[:-1], times)]
        corners[-1] = self._moment.drones
        return _segments(np.moveaxis(corners, 1, 0))

    def _add_surroundings(self) -> None:
        """Add ground, arena and keep-outs."""
        drones = self.scene.drones
        lower, upper = np.min(drones, axis=(0, 1)), np.max(drones, axis=(0, 1))
        size = 2.0 * float(np.max(upper - lower)) + 2.0
        middle = 0.5 * (lower + upper)
        cell = 10.0 ** np.round(np.log10(size / 10.0))
        self._api.add_grid(
            f"{self._name}ground", size, size, plane="xy", cell_size=cell, section_size=5.0 * cell,
            position=(middle[0], middle[1], self.scene.ground), cell_color=(205, 209, 213),
            section_color=(175, 180, 186),
        )  # fmt: skip
        if len(self.scene.appearance.arena):
            self._lines("arena", self.scene.appearance.arena, (ARENA_COLOUR,), EDGE_WIDTH)
        for each in self.scene.appearance.keep_outs:
            self._solid(each.name, each, opacity=0.25)

    def _solid(self, name: str, solid: RigidSurface, opacity: float | None) -> Any:
        """Add one solid."""
        (colour,) = _as_bytes((PALE_COLOUR,) if self._ghost else solid.colours).tolist()
        return self._api.add_mesh_simple(
            f"{self._name}{name}", *mesh(solid.faces), color=tuple(colour), opacity=opacity,
            flat_shading=True, side="double", cast_shadow=False,
        )  # fmt: skip

    def _batch(
        self, name: str, faces: Array, colours: Any, opacity: float | None = None, count: int = 0
    ) -> Any:
        """Add a shape at the positions of all drones, or of the first ``count``."""
        places = self._moment.drones[: count or None]
        return self._api.add_batched_meshes_simple(
            f"{self._name}{name}", *mesh(faces), _identities(len(places)), _float32(places),
            batched_colors=colours, opacity=opacity, lod="off", side="double", cast_shadow=False,
            receive_shadow=False,
        )  # fmt: skip

    def _lines(
        self, name: str, points: NDArray[Any], colours: Sequence[str], thickness: float = 0.01,
        units: str = "world",
    ) -> Any:  # fmt: skip
        """Add segments (m, 2, 3) [m]; each colour applies to an equal number of them."""
        colours_per_segment = self._per_segment(colours, len(points))
        return self._api.add_line_segments(
            f"{self._name}{name}", _float32(points), colours_per_segment, thickness=thickness,
            thickness_units=units,
        )  # fmt: skip

    def _per_segment(self, colours: Sequence[str], count: int) -> NDArray[np.uint8]:
        """Return colours (count, 2, 3), each for an equal number of segments."""
        repeats = count // max(len(colours), 1)
        colours_per_segment = np.repeat(_as_bytes(colours, linear=True), repeats, axis=0)
        return np.repeat(colours_per_segment[:, None], 2, axis=1)


def _float32(values: Array) -> NDArray[np.float32]:
    """Return values in single precision, contiguous in memory."""
    return np.ascontiguousarray(values, dtype=np.float32)


def _identities(count: int) -> NDArray[np.float32]:
    """Return level attitudes (count, 4)."""
    return np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (count, 1))


def _segments(curves: Array) -> NDArray[np.float32]:
    """Return the segments (m, 2, 3) of curves (n, points, 3)."""
    return _float32(np.stack([curves[:, :-1], curves[:, 1:]], axis=2).reshape(-1, 2, 3))


def _as_bytes(colours: Iterable[str], *, linear: bool = False) -> NDArray[np.uint8]:
    """Return colours as bytes (…, 3); viser needs ``linear`` ones for lines and batches."""
    return np.rint(255.0 * rgb(colours, linear=linear)).astype(np.uint8)
