"""A scene drawn in viser: its drones, cables and surroundings at one moment after the other."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch.layout import Layout
from hitchopt.values import Array
from hitchopt.view.cable_curves import CLASPS
from hitchopt.view.drone_shape import SPAN, Triangles, drone_shape
from hitchopt.view.house_colours import (
    MARK_COLOUR,
    cable_colours,
    drone_colours,
    object_colours,
)
from hitchopt.view.live_surroundings import add_surroundings
from hitchopt.view.object_shape import object_shape
from hitchopt.view.path_segments import path_segments
from hitchopt.view.scene import Concerned, Moment, Scene
from hitchopt.view.viser_arrays import (
    as_bytes,
    faded,
    in_linear_light,
    per_segment,
    segments,
    single,
)

Server = Any
"""A viser server; viser is imported only where it is used."""

NEWTON = 0.2
"""Length of an arrow of 1 N [m]."""

MOST_NAMED = 40
"""Number of drones up to which all are named at first: more names hide the scene."""

PALE = (150, 156, 162)
"""Colour of a ghost."""

GHOSTLY = 0.4
"""Opacity of objects of a ghost, or of an old plan."""

PATH_POINTS = 60_000
"""Largest number of samples of all paths."""

PATH_TOLERANCE = 0.002
"""Largest distance of a drawn path to its samples [m]; from 1.5 m a pixel is about as much."""

PATH_WIDTH = 1.2
"""Width of a path [pixels]: thinner ones are drawn with gaps."""

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0], np.float32)
"""Attitude of what is not turned."""

SWITCHES = ("paths", "downwash ellipsoids", "forces", "thrusts", "names")


class LiveScene:
    """A scene in the browser.

    Parameters
    ----------
    server: a viser server.
    scene: what is drawn.
    name: beginning of all names in the server's scene, ending in a slash.
    ghost: whether it is drawn pale, without surroundings and switches.
    """

    def __init__(self, server: Server, scene: Scene, name: str, *, ghost: bool = False) -> None:
        self.scene, self._api, self._name, self._ghost = scene, server.scene, name, ghost
        self._marked = Concerned()
        self.shown: dict[str, bool] = {}
        motion = scene.motion
        team, separation = motion.team, motion.requirements.separation
        self._moment = scene.at(0.0)
        self._size = SPAN * separation.radius
        colours = as_bytes(drone_colours(team)) if not ghost else None
        self._drones = self._add_drones(separation.radius, colours)
        self._cable_colours = as_bytes(cable_colours(team.robots))
        if ghost:
            self._cable_colours = np.tile(np.array(PALE, np.uint8), (team.robots, 1))
        self._cables = self._lines(
            "cables", segments(self._moment.cables), thickness=2.0 * scene.radius
        )
        self._objects = self._add_objects()
        self._bright = [(batch, np.array(batch.batched_colors)) for batch in self._drones]
        self._pale = False
        if ghost:
            self.show(0.0)
            return
        sphere = _sphere()
        ellipsoid = (separation.radius, separation.radius, separation.height)
        self._shells = self._batch(
            "ellipsoids", Triangles(sphere.vertices * ellipsoid, sphere.faces), (42, 140, 130), 0.15
        )
        marks = Triangles(1.5 * self._size * sphere.vertices, sphere.faces)
        self._marks = self._batch("marks", marks, MARK_COLOUR, 0.5, count=1)
        self._arrows = {
            "forces": self._arrow("forces", (200, 65, 79)),
            "thrusts": self._arrow("thrusts", (11, 60, 93)),
        }
        self._paths = self._lines("paths", *_paths(scene), thickness=PATH_WIDTH, units="screen")
        self._labels = [
            self._api.add_label(f"{name}names/{drone}", drone, position=tuple(place))
            for drone, place in zip(team.drone_names, self._moment.drones, strict=True)
        ]
        add_surroundings(self._api, name, scene)
        few = len(team.drone_names) <= MOST_NAMED
        self.shown = {switch: few and switch in ("paths", "names") for switch in SWITCHES}
        self.show(0.0)

    def show(self, time: float) -> None:
        """Draw the scene at a time [s]."""
        self._moment = moment = self.scene.at(time)
        turns = moment.quaternions / np.linalg.norm(moment.quaternions, axis=-1, keepdims=True)
        for batch in self._drones:
            batch.batched_positions, batch.batched_wxyzs = single(moment.drones), single(turns)
        if self.scene.motion.team.has_cables:
            self._cables.points = segments(moment.cables)
        for solid, pose in zip(self._objects, moment.objects, strict=True):
            solid.position, solid.wxyz = pose[:3], pose[3:] / np.linalg.norm(pose[3:])
        if not self._ghost:
            self._show_switched(moment, turns)
            self._show_marks(moment)

    def remove(self) -> None:
        """Take it out of the browser's scene."""
        self._api.remove_by_name(self._name.rstrip("/"))

    def switch(self, name: str, *, on: bool) -> None:
        """Show or hide paths, ellipsoids, forces, thrusts or names."""
        self.shown[name] = on
        self._show_switched(self._moment, self._moment.quaternions)

    def mark(self, marked: Concerned) -> None:
        """Highlight drones, cables and vertices."""
        self._marked = marked
        colours = faded(self._cable_colours) if self._pale else self._cable_colours.copy()
        colours[list(marked.cables)] = MARK_COLOUR
        if len(colours):
            self._cables.colors = in_linear_light(per_segment(colours, self._moment.cables))
        self._show_marks(self._moment)

    def fade(self, *, on: bool) -> None:
        """Draw drones and cables pale, without their paths, or as they are again."""
        if on == self._pale:
            return
        self._pale = on
        for batch, colours in self._bright:
            batch.batched_colors = faded(colours) if on else colours.copy()
        for solid in self._objects:
            solid.opacity = GHOSTLY if on else None
        self.mark(self._marked)
        self._show_switched(self._moment, self._moment.quaternions)

    def vertex_places(self) -> Array:
        """Return where the bends of clasps are drawn now (clasps, 3) [m]."""
        layout: Layout = self.scene.motion.team.layout
        return np.asarray(self._moment.cables[layout.ahead, CLASPS[0]])

    def _show_switched(self, moment: Moment, turns: Array) -> None:
        self._shells.visible = self.shown["downwash ellipsoids"]
        self._paths.visible = self.shown["paths"] and not self._pale
        for label, place in zip(self._labels, moment.drones, strict=True):
            label.visible = self.shown["names"]
            if label.visible:
                label.position = tuple(place)
        if self._shells.visible:
            self._shells.batched_positions = single(moment.drones)
        w, x, y, z = np.moveaxis(turns, -1, 0)
        up = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)
        vectors = {"forces": moment.cable_forces, "thrusts": moment.thrusts[:, None] * up}
        for name, vector in vectors.items():
            arrow = self._arrows[name]
            arrow.visible = self.shown[name]
            if arrow.visible:
                ends = [moment.drones, moment.drones + NEWTON * vector]
                arrow.points = np.stack(ends, axis=1).astype(np.float32)

    def _show_marks(self, moment: Moment) -> None:
        layout = self.scene.motion.team.layout
        clasps = np.isin(layout.clasps, self._marked.vertices)
        places = [moment.drones[list(self._marked.drones)]]
        if np.any(clasps):
            places.append(self.vertex_places()[clasps])
        points = np.concatenate(places)
        self._marks.visible = len(points) > 0
        if len(points):
            self._marks.batched_positions = single(points)
            self._marks.batched_wxyzs = np.tile(UPRIGHT, (len(points), 1))

    def _add_drones(self, radius: float, colours: NDArray[np.uint8] | None) -> list[Any]:
        shape = drone_shape(radius)
        if colours is None:
            parts = (shape.frame, shape.rotors)
            return [self._batch(f"drones/{i}", part, PALE, 0.5) for i, part in enumerate(parts)]
        open_rotors = np.array([name[0] == "r" for name in self.scene.motion.team.drone_names])
        fills = np.where(open_rotors[:, None], np.uint8(255), colours)
        return [
            self._batch("drones/frame", shape.frame, (43, 47, 51)),
            self._batch("drones/rotors", shape.rotors, fills),
            self._batch("drones/rims", shape.rims, colours),
        ]

    def _add_objects(self) -> list[Any]:
        motion = self.scene.motion
        bodies, colours = motion.requirements.objects, as_bytes(object_colours(motion))
        meshes = [object_shape(body) for body in bodies.values()]
        return [
            self._api.add_mesh_simple(
                f"{self._name}objects/{name}", mesh.vertices.astype(np.float32),
                mesh.faces.astype(np.uint32), color=PALE if self._ghost else tuple(colour.tolist()),
                opacity=GHOSTLY if self._ghost else None, flat_shading=True, side="double",
                cast_shadow=False,
            )
            for name, mesh, colour in zip(bodies, meshes, colours, strict=True)
        ]  # fmt: skip

    def _batch(
        self, name: str, mesh: Triangles, colours: Any, opacity: float | None = None, count: int = 0
    ) -> Any:
        places = self._moment.drones[: count or None]
        return self._api.add_batched_meshes_simple(
            f"{self._name}{name}",
            mesh.vertices.astype(np.float32),
            mesh.faces.astype(np.uint32),
            np.tile(UPRIGHT, (len(places), 1)),
            single(places),
            batched_colors=in_linear_light(colours) if isinstance(colours, np.ndarray) else colours,
            opacity=opacity,
            lod="off",
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )

    def _lines(
        self, name: str, points: Any, colours: Any = None, thickness: float = 0.01,
        units: str = "world",
    ) -> Any:  # fmt: skip
        if colours is None:
            colours = per_segment(self._cable_colours, self._moment.cables)
        return self._api.add_line_segments(
            f"{self._name}{name}", single(points), in_linear_light(colours), thickness=thickness,
            thickness_units=units,
        )  # fmt: skip

    def _arrow(self, name: str, colour: tuple[int, int, int]) -> Any:
        points = np.repeat(self._moment.drones[:, None], 2, axis=1)
        shades = np.tile(np.array(colour, np.uint8), (*points.shape[:2], 1))
        return self._lines(name, points, shades)


def _paths(scene: Scene) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return the segments of the drones' paths and their colours, (m, 2, 3) each."""
    drones = scene.drones
    stride = max(1, drones.shape[0] * drones.shape[1] // PATH_POINTS)
    ends, owners = path_segments(np.moveaxis(drones[::stride], 1, 0), PATH_TOLERANCE)
    pale = 0.5 * as_bytes(drone_colours(scene.motion.team)) + 120.0
    return single(ends), np.repeat(pale.astype(np.uint8)[owners][:, None], 2, axis=1)


def _sphere() -> Triangles:
    """Return a unit sphere."""
    rows, columns = 9, 16
    polar, around = np.meshgrid(
        np.linspace(0.0, np.pi, rows), np.linspace(0.0, 2.0 * np.pi, columns, endpoint=False),
        indexing="ij",
    )  # fmt: skip
    points = [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)]
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    a, b = i * columns + j, i * columns + (j + 1) % columns
    faces = [np.stack([a, a + columns, b], -1), np.stack([b, a + columns, b + columns], -1)]
    vertices = np.stack(points, axis=-1).reshape(-1, 3)
    return Triangles(vertices, np.concatenate(faces).reshape(-1, 3).astype(np.int32))
