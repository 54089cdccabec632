"""A scene drawn in viser: drones, cables and surroundings, one moment after the other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.values import Array
from hitchopt.view.cables import CLASPS
from hitchopt.view.scene import Concerned, Scene
from hitchopt.view.shapes import SPAN, Solid, mesh, sphere_faces
from hitchopt.view.style import MARK_COLOUR, rgb

Server = Any  # A viser server; viser is imported only where it is used
NEWTON = 0.2  # Length of an arrow of 1 N [m]
MOST_NAMED = 40  # Number of drones up to which all are named at first: more names hide the scene
# Colour of a ghost and of an old plan's cables, and opacity of their drones and objects
PALE, GHOSTLY = "#969ca2", 0.4
# Time that a trail lasts [s], its corners, and the most segments of all trails: browsers that draw
# by software are slow with more
TRAIL, CORNERS, MOST_SEGMENTS = 5.0, 41, 4000
# Width of a trail [pixels], as thinner ones have gaps, and of the arena's edges [m]
TRAIL_WIDTH, EDGE = 1.2, 0.006
ARENA_COLOUR, SHELL_COLOUR = "#cbcbcb", "#2a8c82"
ARROWS = {"forces": "#c8414f", "thrusts": "#0b3c5d"}  # Colours of the drones' arrows

SWITCHES = ("trails", "downwash ellipsoids", "forces", "thrusts", "names")


class LiveScene:
    """A scene in the browser.

    All its names in the server's scene begin with ``name``, which ends in a slash. A ghost is drawn
    pale, without surroundings and switches.
    """

    def __init__(self, server: Server, scene: Scene, name: str, *, ghost: bool = False) -> None:
        self.scene, self._api, self._name, self._ghost = scene, server.scene, name, ghost
        self._marked, self._pale = Concerned(), False
        self._time, self._moment = 0.0, scene.at(0.0)
        few = scene.drones.shape[1] <= MOST_NAMED
        self.shown = {switch: few and switch in ("trails", "names") for switch in SWITCHES}
        colours, cables = scene.appearance.cable_colours, _segments(self._moment.cables)
        self._cable_colours = (PALE,) * len(colours) if ghost else colours
        self._cables = self._lines("cables", cables, self._cable_colours, 2.0 * scene.radius)
        self._drones, self._objects = self._add_drones(), self._add_objects()
        if not ghost:
            self._add_switched()
            self._add_surroundings()
        self._draw()

    def show(self, time: float) -> None:
        """Draw the scene at a time [s]."""
        self._time, self._moment = time, self.scene.at(time)
        self._draw()

    def remove(self) -> None:
        """Take it out of the browser's scene."""
        self._api.remove_by_name(self._name.rstrip("/"))

    def switch(self, name: str, *, on: bool) -> None:
        """Show or hide trails, ellipsoids, forces, thrusts or names."""
        self.shown[name] = on
        self._draw()

    def mark(self, marked: Concerned) -> None:
        """Highlight drones, cables and vertices."""
        self._marked = marked
        self._paint()

    def fade(self, *, on: bool) -> None:
        """Draw drones and cables pale, without their trails, or as they are again."""
        if on != self._pale:
            self._pale = on
            self._paint()

    def _paint(self) -> None:
        """Give everything the colours that it has now."""
        for solid in (*self._drones, *self._objects):
            solid.opacity = GHOSTLY if self._pale else None
        colours = [PALE if self._pale else colour for colour in self._cable_colours]
        for k in self._marked.cables:
            colours[k] = MARK_COLOUR
        if colours:
            self._cables.colors = self._per_segment(colours, len(self._cables.points))
        self._draw()

    def _draw(self) -> None:
        """Put everything to its place."""
        moment, shown = self._moment, self.shown
        turns = moment.quaternions / np.linalg.norm(moment.quaternions, axis=-1, keepdims=True)
        for batch in self._drones:
            batch.batched_positions, batch.batched_wxyzs = _single(moment.drones), _single(turns)
        if moment.cables.size:
            self._cables.points = _segments(moment.cables)
        for solid, pose in zip(self._objects, moment.objects, strict=True):
            solid.position, solid.wxyz = pose[:3], pose[3:] / np.linalg.norm(pose[3:])
        if self._ghost:
            return
        self._trails.visible = shown["trails"] and not self._pale
        if self._trails.visible:
            self._trails.points = self._trail()
        self._shells.visible = shown["downwash ellipsoids"]
        if self._shells.visible:
            self._shells.batched_positions = _single(moment.drones)
        for label, place in zip(self._labels, moment.drones, strict=True):
            label.visible = shown["names"]
            if label.visible:
                label.position = tuple(place)
        w, x, y, z = np.moveaxis(moment.quaternions, -1, 0)
        up = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)
        vectors = {"forces": moment.cable_forces, "thrusts": moment.thrusts[:, None] * up}
        for name, vector in vectors.items():
            self._arrows[name].visible = shown[name]
            if shown[name]:
                ends = [moment.drones, moment.drones + NEWTON * vector]
                self._arrows[name].points = _single(np.stack(ends, axis=1))
        clasps = self.scene.appearance.clasps
        here = [each.cable for each in clasps if each.vertex in self._marked.vertices]
        marked = moment.cables[here, CLASPS[0]]
        balls = np.concatenate([moment.drones[list(self._marked.drones)], marked])
        self._marks.visible = len(balls) > 0
        if len(balls):
            self._marks.batched_positions = _single(balls)
            self._marks.batched_wxyzs = _upright(len(balls))

    def _add_drones(self) -> list[Any]:
        opacity, batches = GHOSTLY if self._ghost else None, []
        for part in self.scene.appearance.drone_parts():
            colours = _as_bytes((PALE,))[0] if self._ghost else _as_bytes(part.colours, linear=True)
            batches.append(self._batch(f"drones/{part.name}", part.faces, colours, opacity))
        return batches

    def _add_objects(self) -> list[Any]:
        opacity, objects = GHOSTLY if self._ghost else None, self.scene.appearance.objects
        return [self._solid(f"objects/{each.name}", each, opacity=opacity) for each in objects]

    def _add_switched(self) -> None:
        """Add the parts that have switches, and the balls that mark."""
        look, drones = self.scene.appearance, self._moment.drones
        shell, marked = _as_bytes((SHELL_COLOUR, MARK_COLOUR))
        self._shells = self._batch("ellipsoids", sphere_faces(look.ellipsoid), shell, 0.15)
        reach = sphere_faces(1.5 * SPAN * look.ellipsoid[0])
        self._marks = self._batch("marks", reach, marked, 0.5, count=1)
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
        """Return the segments of all drones' paths until now."""
        count = min(CORNERS, max(2, MOST_SEGMENTS // self.scene.drones.shape[1]))
        times = np.maximum(np.linspace(self._time - TRAIL, self._time, count), 0.0)
        corners = self.scene.drones[np.searchsorted(self.scene.t[:-1], times)]
        corners[-1] = self._moment.drones
        return _segments(np.moveaxis(corners, 1, 0))

    def _add_surroundings(self) -> None:
        """Add ground, arena and keep-outs."""
        requirements, drones = self.scene.motion.requirements, self.scene.drones
        lower, upper = np.min(drones, axis=(0, 1)), np.max(drones, axis=(0, 1))
        size, middle = 2.0 * float(np.max(upper - lower)) + 2.0, 0.5 * (lower + upper)
        cell = 10.0 ** np.round(np.log10(size / 10.0))
        self._api.add_grid(
            f"{self._name}ground", size, size, plane="xy", cell_size=cell, section_size=5.0 * cell,
            position=(middle[0], middle[1], requirements.floor), cell_color=(205, 209, 213),
            section_color=(175, 180, 186),
        )  # fmt: skip
        if len(self.scene.appearance.arena):
            self._lines("arena", self.scene.appearance.arena, (ARENA_COLOUR,), EDGE)
        for each in self.scene.appearance.keep_outs:
            self._solid(each.name, each, opacity=0.25)

    def _solid(self, name: str, solid: Solid, opacity: float | None) -> Any:
        """Add one solid."""
        (colour,) = _as_bytes((PALE,) if self._ghost else solid.colours).tolist()
        return self._api.add_mesh_simple(
            f"{self._name}{name}", *mesh(solid.faces), color=tuple(colour), opacity=opacity,
            flat_shading=True, side="double", cast_shadow=False,
        )  # fmt: skip

    def _batch(
        self, name: str, faces: Array, colours: Any, opacity: float | None = None, count: int = 0
    ) -> Any:
        """Add one shape at the places of all drones, or of the first ones."""
        places = self._moment.drones[: count or None]
        return self._api.add_batched_meshes_simple(
            f"{self._name}{name}", *mesh(faces), _upright(len(places)), _single(places),
            batched_colors=colours, opacity=opacity, lod="off", side="double", cast_shadow=False,
            receive_shadow=False,
        )  # fmt: skip

    def _lines(
        self, name: str, points: NDArray[Any], colours: Sequence[str], thickness: float = 0.01,
        units: str = "world",
    ) -> Any:  # fmt: skip
        """Add segments (m, 2, 3) [m]; every colour is that of equally many."""
        shades = self._per_segment(colours, len(points))
        return self._api.add_line_segments(
            f"{self._name}{name}", _single(points), shades, thickness=thickness,
            thickness_units=units,
        )  # fmt: skip

    def _per_segment(self, colours: Sequence[str], count: int) -> NDArray[np.uint8]:
        """Return colours (count, 2, 3), each for equally many segments."""
        each = count // max(len(colours), 1)
        return np.repeat(
            np.repeat(_as_bytes(colours, linear=True), each, axis=0)[:, None], 2, axis=1
        )


def _single(values: Array) -> NDArray[np.float32]:
    """Return values in single precision, one after the other in memory."""
    return np.ascontiguousarray(values, dtype=np.float32)


def _upright(count: int) -> NDArray[np.float32]:
    """Return upright attitudes (count, 4)."""
    return np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (count, 1))


def _segments(curves: Array) -> NDArray[np.float32]:
    """Return the segments (m, 2, 3) of curves (n, points, 3)."""
    return _single(np.stack([curves[:, :-1], curves[:, 1:]], axis=2).reshape(-1, 2, 3))


def _as_bytes(colours: Iterable[str], *, linear: bool = False) -> NDArray[np.uint8]:
    """Return colours as bytes (…, 3); ``linear`` as viser takes those of lines and batches."""
    return np.rint(255.0 * rgb(colours, linear=linear)).astype(np.uint8)
