"""Scenes as flat polygons, and storyboards: panels of a plan's key moments at one scale.

Polygons are painted from far to near. Cables have pale edges, which show over and under also in
grey.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba_array
from matplotlib.gridspec import SubplotSpec
from matplotlib.patheffects import withStroke
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar
from scipy.spatial.transform import Rotation

from hitchopt.geometry.vectors import left_of, unit
from hitchopt.motion.flight import Flight
from hitchopt.values import Array
from hitchopt.view import style
from hitchopt.view.scene import SEGMENTS, Moment, Scene, TeamLabel, normals, scene_at, subdivide

CASING_WIDTH = 1.8  # Width of a cable with its pale edges, in half widths of the cable
OVERLAP = 0.5  # Overlap of a cable's segments to avoid gaps in bends, in half widths of the cable
SHADOW = "#e4e7ea"  # Colour of shadows
GRID_COLOUR = "0.93"  # Colour of the grid on the ground
GRID_CELLS = 6.0  # Largest number of its cells along the longest path
GRID_REACH = 4.0  # Reach of paths below which cells are not smaller [m]
MIN_ROTOR_CORNERS = 4  # Minimum number of a rotor's corners
SUBDIVISIONS = 3  # Number of subdivisions of an object's faces, for sorting by distance
LIGHT = unit(np.array([-0.35, -0.55, 1.0]))  # Direction to the light
MIN_BRIGHTNESS = 0.62  # Brightness of faces that point away from the light
MAX_PANELS = 9  # Maximum number of panels that are large enough to read
FEW_PANELS = 3  # Number of panels up to which another picture fits
MOTION_PANELS = 5  # Number of panels up to which moments of motions are added
# Factor of the reduction of corners, by maximum number of robots
CORNER_STEPS = {12: 1, 30: 2, 100: 4, math.inf: 8}
MIN_TRAVEL = 1e-3  # Minimum travel of some drone between two panels [m]
PRIORITY_TRAVEL = 1e6  # Travel that is added to the rank of essential moments [m]
TINY_STEP = 1e-9  # Least path between two samples [m], so that path lengths increase
AZIMUTH = -115.0  # Azimuth of the camera [deg]
ELEVATION = 38.0  # Elevation of the camera [deg]
# Radius of a drawn cable as a fraction of the extent, large enough to show clasps in small panels
THICKNESS = 0.011
MARGIN = 0.08  # Margin as a fraction of a panel's height
MIN_DRONE_SIZE = 0.03  # Minimum radius of a drone as a fraction of a panel's height
PATH_SAMPLES = 150  # Number of points of a drone's path
PATH_OPACITY = 0.45  # Opacity of a drone's path
LETTER_WIDTH = 5.6  # Width of a bold small letter [points]
TITLE_LETTER_WIDTH = 4.6  # Mean width of a letter of a panel's title [points]
LINE_HEIGHT = 10.0  # Line height [points]


@dataclass(frozen=True, eq=False)
class Camera:
    """Camera with parallel projection."""

    axes: Array  # (3, 3) unit vectors to the right, up and to the viewer, in world coordinates

    @classmethod
    def at_angles(cls, azimuth: float, elevation: float) -> Camera:
        """Return the camera at an azimuth and an elevation [deg]."""
        a, e = np.radians([azimuth, elevation])
        back = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        right = np.array([-np.sin(a), np.cos(a), 0.0])
        return cls(np.stack([right, np.cross(back, right), back]))

    def project(self, points: Array) -> Array:
        """Return points (…, 3) [m] in coordinates right, up and to the viewer (…, 3) [m]."""
        return np.asarray(points @ self.axes.T)


class Painting(NamedTuple):
    """Polygons in painting order."""

    polygons: Array  # (m, 4, 2) [m], right and up; a triangle has its last corner twice
    colours: Array  # (m, 4), red, green, blue, opacity


class Painter:
    """Painter of moments of a scene.

    ``width`` is a cable's drawn half width [m], 0 for the scene's radius; ``size`` a factor of the
    drones' sizes; ``step`` divides the number of corners of rotors and cables.
    """

    def __init__(
        self, scene: Scene, camera: Camera, width: float = 0.0, size: float = 1.0, step: int = 1
    ) -> None:
        requirements = scene.flight.requirements
        look = scene.appearance
        self.camera = camera
        self.step = step
        self._floor = scene.ground
        self._width = width or scene.radius
        self.cables = to_rgba_array(look.cable_colours)
        parts = look.drone_parts(size, max(MIN_ROTOR_CORNERS, SEGMENTS // step))
        # Only the front faces of frames, which are solid, are painted.
        self._parts = [(x.faces, to_rgba_array(x.colours), x.name == "frame") for x in parts]
        # Offsets sort objects above their tables, and on top of cables, which are drawn thicker.
        bodies = [*requirements.objects.values()]
        for other in scene.flight.others:
            bodies += other.motion.requirements.objects.values()
        offsets = (
            body.circumradius / 2**SUBDIVISIONS if body.fixed else -2.0 * self._width
            for body in bodies
        )
        self._objects = [
            (subdivide(solid.faces, SUBDIVISIONS), to_rgba_array(solid.colours), offset)
            for solid, offset in zip(look.objects, offsets, strict=True)
        ]

    def paint(self, moment: Moment) -> Painting:
        """Return the painting of a moment: shadows, then everything else from far to near."""
        layers = [*self._drones(moment), *self._bodies(moment)]
        cables = moment.cables[:, :: self.step]
        cable_colours = np.repeat(self.cables, cables.shape[1] - 1, axis=0)
        casing = np.broadcast_to(to_rgba_array(style.HOLLOW_COLOUR), cable_colours.shape)
        layers += [
            (self._strips(cables, CASING_WIDTH * self._width, 0.0), casing, self._width),
            (self._strips(cables, self._width, OVERLAP * self._width), cable_colours, 0.0),
        ]
        polygons = np.concatenate([faces for faces, _, _ in layers])
        colours = np.concatenate([face_colours for _, face_colours, _ in layers])
        nearness = [np.mean(faces[..., 2], axis=1) - offset for faces, _, offset in layers]
        order = np.argsort(np.concatenate(nearness), kind="stable")
        ground = cables * [1.0, 1.0, 0.0] + [0.0, 0.0, self._floor]
        shadows = self._strips(ground, self._width, 0.0)
        shadow_colours = np.broadcast_to(to_rgba_array(SHADOW), (len(shadows), 4))
        return Painting(
            np.concatenate([shadows, polygons[order]])[..., :2],
            np.concatenate([shadow_colours, colours[order]]),
        )

    def _drones(self, moment: Moment) -> list[tuple[Array, Array, float]]:
        """Return projected faces, their colours, and the offset of their distance [m]."""
        turns = Rotation.from_quat(moment.quaternions, scalar_first=True).as_matrix()
        layers = []
        for part, part_colours, is_solid in self._parts:
            corners = np.einsum("dij,fvj->dfvi", turns, part) + moment.drones[:, None, None]
            faces = self.camera.project(corners).reshape(-1, 4, 3)
            colours = np.repeat(part_colours, len(part), axis=0)
            visible: Any = normals(faces)[:, 2] > 0.0 if is_solid else slice(None)
            layers.append((faces[visible], colours[visible], 0.0))
        return layers

    def _bodies(self, moment: Moment) -> list[tuple[Array, Array, float]]:
        """Return the visible faces of objects, their shaded colours and offsets of distance [m]."""
        layers = []
        for (faces, fill, offset), pose in zip(self._objects, moment.objects, strict=True):
            turn = Rotation.from_quat(pose[3:], scalar_first=True).as_matrix()
            placed = faces @ turn.T + pose[:3]
            outward = normals(placed)
            visible = outward @ self.camera.axes[2] > 0.0
            light = np.maximum(outward[visible] @ LIGHT, 0.0)
            colours = np.repeat(fill, len(light), axis=0)
            colours[:, :3] *= (MIN_BRIGHTNESS + (1.0 - MIN_BRIGHTNESS) * light)[:, None]
            layers.append((self.camera.project(placed[visible]), colours, offset))
        return layers

    def _strips(self, curves: Array, width: float, extension: float) -> Array:
        """Return the segments of curves (n, points, 3) as projected quadrangles (m, 4, 3) [m].

        ``width`` is a segment's half width, ``extension`` is added at both ends [m].
        """
        points = self.camera.project(curves)
        first = points[:, :-1].reshape(-1, 3)
        last = points[:, 1:].reshape(-1, 3)
        along = unit((last - first) * [1.0, 1.0, 0.0])
        across = width * left_of(along)
        first = first - extension * along
        last = last + extension * along
        return np.stack([first - across, first + across, last + across, last - across], axis=1)


class Shot(NamedTuple):
    """A moment with a panel and its title."""

    words: str
    time: float  # from the plan's start [s]
    essential: bool = False  # whether it has priority if there are more than MAX_PANELS


def choose_shots(flight: Flight) -> tuple[Shot, ...]:
    """Return start, swaps, the hitch, ends of its motions, passages, and the plan's end.

    Of more than MAX_PANELS, those with the longest paths before them are chosen.
    """
    shots = [Shot("start", 0.0, essential=True)]
    for (_, state), phases in groupby(flight.phases, lambda phase: (phase.step, phase.state)):
        group = list(phases)
        if state.clasping:
            middle = 0.5 * (group[0].start + group[0].end)
            shots.append(Shot(group[0].name.rstrip(" 0123456789"), middle, essential=True))
        elif state.hitched and group[-1].name == "tension":
            shots.append(Shot("hitched", group[-1].end, essential=True))
        elif not state.slack:
            shots += [Shot(phase.name, phase.end) for phase in group if phase.name != "relax"]
    shots.append(Shot("end", flight.duration, essential=True))
    shots = sorted([*shots, *_passages(flight, shots)], key=lambda shot: shot.time)
    times = np.clip([shot.time for shot in shots], 0.0, flight.duration)
    places = flight.drones.at(flight.drones.breaks[0] + times)
    travel = np.max(np.linalg.norm(np.diff(places, axis=0), axis=-1), axis=-1)
    travel = np.concatenate([[np.inf], travel])
    moved = np.flatnonzero(travel > MIN_TRAVEL)
    rank = travel[moved] + np.where([shots[i].essential for i in moved], PRIORITY_TRAVEL, 0.0)
    rank[-1] = np.inf
    return tuple(shots[i] for i in np.sort(moved[np.argsort(-rank, kind="stable")[:MAX_PANELS]]))


def shots_in_motion(flight: Flight, count: int = MOTION_PANELS) -> tuple[Shot, ...]:
    """Return the shots of a plan and, if they are fewer than ``count``, moments of its motions.

    These divide the longest paths between two shots into equal parts.
    """
    shots = choose_shots(flight)
    times = np.linspace(0.0, flight.duration, PATH_SAMPLES)
    places = flight.drones.at(flight.drones.breaks[0] + times)
    steps = np.max(np.linalg.norm(np.diff(places, axis=0), axis=-1), axis=-1)
    travel = np.concatenate([[0.0], np.cumsum(steps + TINY_STEP)])  # [m] of the fastest drones
    reached = np.interp([shot.time for shot in shots], times, travel)
    parts = np.ones(len(shots) - 1, dtype=np.intp)
    lengths = np.diff(reached)
    while np.sum(parts) < count - 1 and np.max(lengths / parts, initial=0.0) > MIN_TRAVEL:
        parts[np.argmax(lengths / parts)] += 1
    paths = zip(reached, lengths, parts, strict=False)
    inner = [begin + size * np.arange(1, n) / n for begin, size, n in paths]
    moments = np.interp(np.concatenate([*inner, []]), travel, times)
    ends = np.array([phase.end for phase in flight.phases])
    names = [*(phase.name for phase in flight.phases), "end"]
    added = [Shot(names[np.searchsorted(ends, time)], time) for time in moments.tolist()]
    return tuple(sorted([*shots, *added], key=lambda shot: shot.time))


def _passages(flight: Flight, shots: Sequence[Shot]) -> list[Shot]:
    """Return the times of closest approach to fixed objects that no other shot is near."""
    times = np.linspace(0.0, flight.duration, PATH_SAMPLES)
    moments = np.concatenate([times, [shot.time for shot in shots]])
    places = flight.drones.at(flight.drones.breaks[0] + np.minimum(moments, flight.duration))
    middles = np.mean(places[..., :2], axis=1)
    passages = list[Shot]()
    radius = np.max(np.linalg.norm(places[0, :, :2] - middles[0], axis=1))
    for name, body in flight.requirements.objects.items():
        distances = np.linalg.norm(middles - body.at[:2], axis=1)
        k = int(np.argmin(distances[:PATH_SAMPLES]))
        if body.fixed and distances[k] + radius < np.min(distances[PATH_SAMPLES:]):
            passages.append(Shot(f"near {name}", float(times[k])))
    return passages


def draw_plan_storyboard(place: SubplotSpec, flight: Flight, shots: Sequence[Shot]) -> None:
    """Draw the storyboard of a plan in a part of a figure."""
    times = np.unique([0.0, flight.duration, *(min(s.time, flight.duration) for s in shots)])
    paths = np.unique(np.append(np.linspace(0.0, flight.duration, PATH_SAMPLES), times))
    flown = flight.drones.at(flight.drones.breaks[0] + paths)
    draw_storyboard(place, scene_at(flight, times, THICKNESS), shots, (paths, flown))


def draw_storyboard(
    place: SubplotSpec, scene: Scene, shots: Sequence[Shot], flown: tuple[Array, Array]
) -> None:
    """Draw the panels of a scene, whose samples include the times of all shots.

    ``flown`` are the paths: times (samples,) [s], including the shots', and positions of the drones
    (samples, drones, 3) [m].
    """
    radius = scene.flight.requirements.separation.radius
    count = len(shots)
    drones = scene.drones.shape[1]
    camera = Camera.at_angles(AZIMUTH, ELEVATION)
    moments = [int(np.argmin(np.abs(scene.t - shot.time))) for shot in shots]
    boxes = np.array([_panel_box(scene.at(float(scene.t[i])), scene, camera) for i in moments])
    middles = np.mean(boxes, axis=1)
    half = np.max(np.ptp(boxes, axis=1), axis=0) * (0.5 + MARGIN) + radius
    layout: Any = place.get_gridspec()
    figure = layout.figure
    space = figure.get_size_inches() * place.get_position(figure).size / half
    scales = [min(space[0] / c, space[1] / math.ceil(count / c)) for c in range(1, count + 1)]
    columns = 1 + int(np.argmax(scales))
    rows = math.ceil(count / columns)
    grid: Any = place.subgridspec(rows, columns, wspace=0.04, hspace=0.05 * rows)
    size = max(1.0, MIN_DRONE_SIZE * min(1.0, 4.0 / math.sqrt(drones)) / radius * 2.0 * half[1])
    painter = Painter(scene, camera, scene.radius, size, corner_step(scene.cables.shape[1]))
    paths = camera.project(flown[1])[..., :2]
    reached = np.searchsorted(flown[0], scene.t[moments])
    for k, (shot, i, middle) in enumerate(zip(shots, moments, middles, strict=True)):
        axes: Axes = figure.add_subplot(grid[k // columns, k % columns])
        width = axes.get_position().width
        lines = np.moveaxis(paths[reached[max(k - 1, 0)] : reached[k] + 1], 1, 0)
        draw_ground(axes, scene, camera)
        style.draw_lines(axes, lines, scene.appearance.drone_colours, 0.6, 1, alpha=PATH_OPACITY)
        draw_painting(axes, painter.paint(scene.at(float(scene.t[i]))))
        axes.set(xticks=[], yticks=[], xmargin=0.0, ymargin=0.0)
        axes.set_aspect("equal", adjustable="datalim")
        axes.update_datalim([middle - half, middle + half])
        axes.autoscale_view()
        axes.spines[:].set_color("0.85")
        places = camera.project(scene.drones[i])[:, :2]
        write_labels(axes, scene.appearance.labels, places, size * radius)
        title = f"{shot.words}, {shot.time:.1f} s"
        if TITLE_LETTER_WIDTH * len(title) > 72.0 * figure.get_size_inches()[0] * width:
            title = f"{shot.time:.1f} s"
        axes.set_title(title, fontsize="small", parse_math=False)
    length = 10.0 ** math.floor(math.log10(float(half[0])))
    words: Any = {"loc": "lower right", "borderpad": 0.3}
    words |= {"prop": {"size": "x-small"}, "size_vertical": 0.01 * float(half[1]), "color": "0.3"}
    scale_bar = AnchoredSizeBar(axes.transData, length, f"{length:g} m", **words)
    scale_bar.set_zorder(8)
    scale_bar.patch.set(alpha=0.85, edgecolor="none")
    axes.add_artist(scale_bar)


def _panel_box(moment: Moment, scene: Scene, camera: Camera) -> Array:
    """Return the lower left and upper right corner (2, 2) [m] of a panel's content.

    The content is the drones, down to half of their height, and objects nearby.
    """

    def box(points: Array) -> Array:
        projected = camera.project(points)[:, :2]
        return np.array([np.min(projected, axis=0), np.max(projected, axis=0)])

    low = moment.drones * [1.0, 1.0, 0.5] + [0.0, 0.0, 0.5 * scene.ground]
    boxes = [box(np.concatenate([moment.drones, low]))]
    margin = 0.5 * np.ptp(boxes[0], axis=0)
    for solid, pose in zip(scene.appearance.objects, moment.objects, strict=True):
        turn = Rotation.from_quat(pose[3:], scalar_first=True)
        body = box(turn.apply(solid.faces.reshape(-1, 3)) + pose[:3])
        gap = np.maximum(body[0] - boxes[0][1], boxes[0][0] - body[1])
        body = np.clip(body, boxes[0][0] - 2.0 * margin, boxes[0][1] + 2.0 * margin)
        boxes += [body] * bool(np.all(gap < margin))
    return np.array([np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1]])


def corner_step(robots: int) -> int:
    """Return the painter's step for a number of robots: small shapes need fewer corners."""
    return next(step for limit, step in CORNER_STEPS.items() if robots <= limit)


def draw_ground(axes: Axes, scene: Scene, camera: Camera) -> None:
    """Draw a grid on the ground that extends beyond all paths, against which motion is seen."""
    lower, upper = np.min(scene.drones, axis=(0, 1))[:2], np.max(scene.drones, axis=(0, 1))[:2]
    reach = float(np.max(np.ptp(scene.drones, axis=(0, 1))))
    floor = scene.ground
    least = max(reach, GRID_REACH) / GRID_CELLS
    power = 10.0 ** math.floor(math.log10(least))
    step = power * next(factor for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= least)
    near = (lower - 3.0 * reach) // step * step
    far = (upper + 3.0 * reach) // step * step + step
    across, up = (np.arange(near[i], far[i] + step / 2, step) for i in range(2))
    lines = [[[x, near[1], floor], [x, far[1], floor]] for x in across]
    lines += [[[near[0], y, floor], [far[0], y, floor]] for y in up]
    style.draw_lines(axes, camera.project(np.array(lines))[..., :2], GRID_COLOUR, 0.7, 0)


def draw_painting(axes: Axes, painting: Painting) -> PolyCollection:
    """Draw a painting; edges in the faces' colours close seams."""
    polygons: Any = painting.polygons
    colours: Any = painting.colours
    look: Any = {"facecolors": colours, "edgecolors": "face", "linewidths": 0.6, "zorder": 2}
    shapes = PolyCollection(polygons, **look)
    axes.add_collection(shapes, autolim=False)
    return shapes


def write_labels(axes: Axes, labels: Sequence[TeamLabel], drones: Array, radius: float) -> None:
    """Write the names of teams above or below one of their drones, off all other drones.

    ``drones`` (N, 2) are projected positions of all drones, of a radius [m].
    """
    axes.apply_aspect()
    to_pixels = axes.transData
    pixels = axes.figure.dpi / 72.0
    occupied = to_pixels.transform(drones)
    disc = radius * (to_pixels.transform([1.0, 0.0]) - to_pixels.transform([0.0, 0.0]))[0]
    middle = np.mean(axes.bbox, axis=0)
    reach = 0.5 * np.ptp(axes.bbox, axis=0)
    for label in labels:
        half_text = 0.5 * pixels * np.array([LETTER_WIDTH * len(label.name), LINE_HEIGHT])
        space = half_text + disc + pixels
        spots = np.concatenate([occupied[label.drones] + [0.0, y] for y in (space[1], -space[1])])
        is_inside = np.all(np.abs(spots - middle) < reach - half_text, axis=1)
        clearance = np.min(np.max(np.abs(spots[:, None] - occupied) / space, axis=-1), axis=1)
        distance = np.abs(spots[:, 1] - np.mean(occupied[:, 1]))
        best = np.lexsort([-distance, -np.minimum(clearance, 1.0).round(6) * is_inside])[0]
        occupied = np.vstack([occupied, spots[best]])
        look: Any = {"color": label.colour, "weight": "bold", "zorder": 7, "va": "center"}
        look |= {"clip_on": True, "path_effects": [withStroke(linewidth=2.0, foreground="white")]}
        style.write(axes, label.name, to_pixels.inverted().transform(spots[best]), (0, 0), **look)
