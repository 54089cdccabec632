"""A scene as flat polygons, and a plan as a row of panels: the moments that matter, at one scale.

Polygons are painted the farthest first. Cables have pale edges: over and under differ in grey as
well.
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

from hitchopt.geometry.vectors import unit
from hitchopt.motion.motion import CableState, Motion
from hitchopt.values import Array
from hitchopt.view import style
from hitchopt.view.scene import Moment, Scene, scene_at
from hitchopt.view.shapes import SEGMENTS, GroupName, normals, split

# Width of a cable with its pale edges over that without, and length by which its segments
# overlap, in its radii: bends have no gaps
CASING, OVERLAP = 1.8, 0.5
SHADOW = "#e4e7ea"  # Colour of shadows
# Least number of a rotor's corners, and how often the sides of an object's faces are halved, so
# that near and far faces are sorted apart
FEWEST, SPLITS = 4, 3
# Direction toward the light, and the brightness of a face that is turned away from it
LIGHT, DARKEST = unit(np.array([-0.35, -0.55, 1.0])), 0.62
# Largest number of panels; more would be too small to read. Below FEW another picture fits
MOST, FEW = 9, 3
# Step of the painter up to that number of robots: more are fewer pixels wide
STEPS = {12: 1, 30: 2, 100: 4, math.inf: 8}
# Distance [m] that some drone is off its place in the panel before, else there is none; and one
# beyond all that drones fly, by which some moments come before others
STILL, LONGEST = 1e-3, 1e6
AZIMUTH, ELEVATION = -115.0, 38.0  # Where panels are seen from [deg]
# Radius of a drawn cable as a share of the extent: clasps show over and under in small panels;
# and margin around everything and least reach of a drone, as shares of a panel's height
THICKNESS, MARGIN, SMALL = 0.011, 0.08, 0.03
PATH_SAMPLES, PALE = 150, 0.45  # Number of points of a drone's path, and its opacity
LETTER, LINE = 5.6, 10.0  # Width of a bold small letter, and height of its line [points]


@dataclass(frozen=True, eq=False)
class Camera:
    """A direction from which a scene is seen, from far away."""

    axes: Array  # (3, 3), units to the right, upward, and toward the viewer, in world coordinates

    @classmethod
    def toward(cls, azimuth: float, elevation: float) -> Camera:
        """Return the camera that looks from an azimuth and an elevation [deg]."""
        a, e = np.radians([azimuth, elevation])
        back = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        right = np.array([-np.sin(a), np.cos(a), 0.0])
        return cls(np.stack([right, np.cross(back, right), back]))

    def seen(self, points: Array) -> Array:
        """Return points (…, 3) [m] as right, up and nearness (…, 3) [m]."""
        return np.asarray(points @ self.axes.T)


class Painting(NamedTuple):
    """Polygons in the order in which they are painted."""

    polygons: Array  # (m, 4, 2) [m], right and up; a triangle has its last corner twice
    colours: Array  # (m, 4), red, green, blue, opacity


class Painter:
    """A painter of the moments of one scene.

    ``width`` is half of a cable's drawn width [m], 0 for the scene's; ``size`` a factor of the
    drones' sizes; ``step`` that by which rotors and cables have fewer corners, as small ones may.
    """

    def __init__(
        self, scene: Scene, camera: Camera, width: float = 0.0, size: float = 1.0, step: int = 1
    ) -> None:
        need, look = scene.motion.requirements, scene.appearance
        self.camera, self.step, self._floor = camera, step, need.floor
        self._width = width or scene.radius
        self.cables = to_rgba_array(look.cable_colours)
        parts = look.drone_parts(size, max(FEWEST, SEGMENTS // step))
        # Of frames, which are solid, only what faces the viewer is painted.
        self._parts = [(x.faces, to_rgba_array(x.colours), x.name == "frame") for x in parts]
        # Objects stand on tables, and lie on cables, which are drawn thicker than they are.
        backs = (
            body.circumradius / 2**SPLITS if body.fixed else -2.0 * self._width
            for body in need.objects.values()
        )
        self._objects = [
            (split(solid.faces, SPLITS), to_rgba_array(solid.colours), back)
            for solid, back in zip(look.objects, backs, strict=True)
        ]

    def painted(self, moment: Moment) -> Painting:
        """Return a moment: shadows on the ground, then everything else, the farthest first."""
        layers = [*self._drones(moment), *self._bodies(moment)]
        cables = moment.cables[:, :: self.step]
        shades = np.repeat(self.cables, cables.shape[1] - 1, axis=0)
        casing = np.broadcast_to(to_rgba_array(style.OPEN), shades.shape)
        longer = OVERLAP * self._width
        layers += [
            (self._strips(cables, CASING * self._width, 0.0), casing, self._width),
            (self._strips(cables, self._width, longer), shades, 0.0),
        ]
        polygons = np.concatenate([faces for faces, _, _ in layers])
        colours = np.concatenate([shade for _, shade, _ in layers])
        nearness = [np.mean(faces[..., 2], axis=1) - back for faces, _, back in layers]
        order = np.argsort(np.concatenate(nearness), kind="stable")
        ground = cables * [1.0, 1.0, 0.0] + [0.0, 0.0, self._floor]
        shadows = self._strips(ground, self._width, 0.0)
        dark = np.broadcast_to(to_rgba_array(SHADOW), (len(shadows), 4))
        return Painting(
            np.concatenate([shadows, polygons[order]])[..., :2],
            np.concatenate([dark, colours[order]]),
        )

    def _drones(self, moment: Moment) -> list[tuple[Array, Array, float]]:
        """Return faces as seen, their colours, and how far they are put back [m]."""
        turns = Rotation.from_quat(moment.quaternions, scalar_first=True).as_matrix()
        layers = []
        for part, shades, solid in self._parts:
            corners = np.einsum("dij,fvj->dfvi", turns, part) + moment.drones[:, None, None]
            faces = self.camera.seen(corners).reshape(-1, 4, 3)
            colours = np.repeat(shades, len(part), axis=0)
            shown: Any = normals(faces)[:, 2] > 0.0 if solid else slice(None)
            layers.append((faces[shown], colours[shown], 0.0))
        return layers

    def _bodies(self, moment: Moment) -> list[tuple[Array, Array, float]]:
        """Return the faces of objects that are seen, lit from above; as of ``_drones``."""
        layers = []
        for (faces, fill, back), pose in zip(self._objects, moment.objects, strict=True):
            turn = Rotation.from_quat(pose[3:], scalar_first=True).as_matrix()
            there = faces @ turn.T + pose[:3]
            outward = normals(there)
            shown = outward @ self.camera.axes[2] > 0.0
            bright = DARKEST + (1.0 - DARKEST) * np.maximum(outward[shown] @ LIGHT, 0.0)
            shades = np.repeat(fill, len(bright), axis=0)
            shades[:, :3] *= bright[:, None]
            layers.append((self.camera.seen(there[shown]), shades, back))
        return layers

    def _strips(self, curves: Array, width: float, longer: float) -> Array:
        """Return the segments of curves (n, points, 3) as seen quadrangles (m, 4, 3) [m].

        ``width`` is half of a segment's, and ``longer`` an extension at either end [m].
        """
        seen = self.camera.seen(curves)
        first, last = seen[:, :-1].reshape(-1, 3), seen[:, 1:].reshape(-1, 3)
        along = unit((last - first) * [1.0, 1.0, 0.0])
        aside = width * np.stack([-along[:, 1], along[:, 0], np.zeros(len(along))], axis=-1)
        first, last = first - longer * along, last + longer * along
        return np.stack([first - aside, first + aside, last + aside, last - aside], axis=1)


class Shot(NamedTuple):
    """A moment that has a panel, with words above it."""

    words: str
    time: float  # from the plan's start [s]
    essential: bool = False  # whether it comes before others where there are more than MOST


def chosen_shots(motion: Motion) -> tuple[Shot, ...]:
    """Return start, swaps, the hitch, the end of whatever moves it, passages, and the plan's end.

    Where there are more than MOST, those with the longest paths before them are chosen.
    """
    shots = [Shot("start", 0.0, essential=True)]
    for (_, state), same in groupby(motion.phases, lambda phase: (phase.step, phase.state)):
        group = list(same)
        if state is CableState.CLASPING:
            middle = 0.5 * (group[0].start + group[0].end)
            shots.append(Shot(group[0].name.rstrip(" 0123456789"), middle, essential=True))
        elif state is CableState.HITCHED and group[-1].name == "tension":
            shots.append(Shot("hitched", group[-1].end, essential=True))
        elif state is CableState.ROLLING:
            shots.append(Shot(group[-1].name, group[-1].end))
        elif state in (CableState.HITCHED, CableState.NONE):
            shots += [Shot(phase.name, phase.end) for phase in group if phase.name != "relax"]
    shots.append(Shot("end", motion.duration, essential=True))
    shots = sorted([*shots, *_passages(motion, shots)], key=lambda shot: shot.time)
    times = np.clip([shot.time for shot in shots], 0.0, motion.duration)
    places = motion.drones.at(motion.drones.breaks[0] + times)
    travel = np.max(np.linalg.norm(np.diff(places, axis=0), axis=-1), axis=-1)
    travel = np.concatenate([[np.inf], travel])
    moved = np.flatnonzero(travel > STILL)
    rank = travel[moved] + np.where([shots[i].essential for i in moved], LONGEST, 0.0)
    rank[-1] = np.inf
    return tuple(shots[i] for i in np.sort(moved[np.argsort(-rank, kind="stable")[:MOST]]))


def _passages(motion: Motion, shots: Sequence[Shot]) -> list[Shot]:
    """Return when the drones are nearest to objects that never move and that no shot is near."""
    times = np.linspace(0.0, motion.duration, PATH_SAMPLES)
    moments = np.concatenate([times, [shot.time for shot in shots]])
    places = motion.drones.at(motion.drones.breaks[0] + np.minimum(moments, motion.duration))
    middles, passages = np.mean(places[..., :2], axis=1), list[Shot]()
    reach = np.max(np.linalg.norm(places[0, :, :2] - middles[0], axis=1))
    for name, body in motion.requirements.objects.items():
        off = np.linalg.norm(middles - body.at[:2], axis=1)
        k = int(np.argmin(off[:PATH_SAMPLES]))
        if body.fixed and off[k] + reach < np.min(off[PATH_SAMPLES:]):
            passages.append(Shot(f"near {name}", float(times[k])))
    return passages


def draw_plan_storyboard(place: SubplotSpec, motion: Motion, shots: Sequence[Shot]) -> None:
    """Draw the shots of a plan in a part of a figure."""
    times = np.unique([0.0, motion.duration, *(min(s.time, motion.duration) for s in shots)])
    paths = np.unique(np.append(np.linspace(0.0, motion.duration, PATH_SAMPLES), times))
    flown = motion.drones.at(motion.drones.breaks[0] + paths)
    draw_storyboard(place, scene_at(motion, times, THICKNESS), shots, (paths, flown))


def draw_storyboard(
    place: SubplotSpec, scene: Scene, shots: Sequence[Shot], flown: tuple[Array, Array]
) -> None:
    """Draw the panels of a scene, at whose samples all shots' times are.

    ``flown`` are the paths: times (samples,) [s], the shots' among them, and the drones then
    (samples, drones, 3) [m].
    """
    radius = scene.motion.requirements.separation.radius
    count, drones = len(shots), scene.drones.shape[1]
    camera = Camera.toward(AZIMUTH, ELEVATION)
    moments = [int(np.argmin(np.abs(scene.t - shot.time))) for shot in shots]
    boxes = np.array([_seen_box(scene.at(float(scene.t[i])), scene, camera) for i in moments])
    middles = np.mean(boxes, axis=1)
    half = np.max(np.ptp(boxes, axis=1), axis=0) * (0.5 + MARGIN) + radius
    layout: Any = place.get_gridspec()
    figure = layout.figure
    room = figure.get_size_inches() * place.get_position(figure).size / half
    scales = [min(room[0] / c, room[1] / math.ceil(count / c)) for c in range(1, count + 1)]
    columns = 1 + int(np.argmax(scales))
    rows = math.ceil(count / columns)
    grid: Any = place.subgridspec(rows, columns, wspace=0.04, hspace=0.05 * rows)
    size = max(1.0, SMALL * min(1.0, 4.0 / math.sqrt(drones)) / radius * 2.0 * half[1])
    painter = Painter(scene, camera, scene.radius, size, few_corners(scene.cables.shape[1]))
    paths = camera.seen(flown[1])[..., :2]
    reached = np.searchsorted(flown[0], scene.t[moments])
    for k, (shot, i, middle) in enumerate(zip(shots, moments, middles, strict=True)):
        axes: Axes = figure.add_subplot(grid[k // columns, k % columns])
        lines = np.moveaxis(paths[reached[max(k - 1, 0)] : reached[k] + 1], 1, 0)
        style.draw_lines(axes, lines, scene.appearance.drone_colours, 0.6, 1, alpha=PALE)
        draw_painting(axes, painter.painted(scene.at(float(scene.t[i]))))
        axes.set(xticks=[], yticks=[], xmargin=0.0, ymargin=0.0)
        axes.set_aspect("equal", adjustable="datalim")
        axes.update_datalim([middle - half, middle + half])
        axes.autoscale_view()
        axes.spines[:].set_color("0.85")
        places = camera.seen(scene.drones[i])[:, :2]
        write_groups(axes, scene.appearance.groups, places, size * radius)
        axes.set_title(f"{shot.words}, {shot.time:.1f} s", fontsize="small", parse_math=False)
    length = 10.0 ** math.floor(math.log10(float(half[0])))
    words: Any = {"loc": "lower right", "frameon": False, "borderpad": 0.7}
    words |= {"prop": {"size": "x-small"}, "size_vertical": 0.01 * float(half[1]), "color": "0.3"}
    axes.add_artist(AnchoredSizeBar(axes.transData, length, f"{length:g} m", **words))


def _seen_box(moment: Moment, scene: Scene, camera: Camera) -> Array:
    """Return the lower left and upper right corner (2, 2) [m] of what a panel shows.

    That is drones, down to half of their height, and objects within half of their width.
    """

    def box(points: Array) -> Array:
        seen = camera.seen(points)[:, :2]
        return np.array([np.min(seen, axis=0), np.max(seen, axis=0)])

    floor = scene.motion.requirements.floor
    low = moment.drones * [1.0, 1.0, 0.5] + [0.0, 0.0, 0.5 * floor]
    boxes = [box(np.concatenate([moment.drones, low]))]
    near = 0.5 * np.ptp(boxes[0], axis=0)
    for solid, pose in zip(scene.appearance.objects, moment.objects, strict=True):
        turn = Rotation.from_quat(pose[3:], scalar_first=True)
        body = box(turn.apply(solid.faces.reshape(-1, 3)) + pose[:3])
        apart = np.maximum(body[0] - boxes[0][1], boxes[0][0] - body[1])
        body = np.clip(body, boxes[0][0] - 2.0 * near, boxes[0][1] + 2.0 * near)
        boxes += [body] * bool(np.all(apart < near))
    return np.array([np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1]])


def few_corners(robots: int) -> int:
    """Return the painter's step for a team: small shapes need fewer corners."""
    return next(step for most, step in STEPS.items() if robots <= most)


def draw_painting(axes: Axes, painting: Painting) -> PolyCollection:
    """Draw a painting; edges of the faces' colour close the seams between them."""
    polygons: Any = painting.polygons
    colours: Any = painting.colours
    look: Any = {"facecolors": colours, "edgecolors": "face", "linewidths": 0.2, "zorder": 2}
    shapes = PolyCollection(polygons, **look)
    axes.add_collection(shapes, autolim=False)
    return shapes


def write_groups(axes: Axes, groups: Sequence[GroupName], seen: Array, radius: float) -> None:
    """Write groups' names above their highest or below their lowest drone where no drone is.

    All drones are ``seen`` (N, 2) there, of a radius [m].
    """
    axes.apply_aspect()
    to_pixels, pixels = axes.transData, axes.figure.dpi / 72.0
    taken = to_pixels.transform(seen)
    disc = radius * (to_pixels.transform([1.0, 0.0]) - to_pixels.transform([0.0, 0.0]))[0]
    middle, reach = np.mean(axes.bbox, axis=0), 0.5 * np.ptp(axes.bbox, axis=0)
    for group in groups:
        letters = 0.5 * pixels * np.array([LETTER * len(group.name), LINE])
        room = letters + disc + pixels
        spots = np.concatenate([taken[group.drones] + [0.0, y] for y in (room[1], -room[1])])
        inside = np.all(np.abs(spots - middle) < reach - letters, axis=1)
        free = np.min(np.max(np.abs(spots[:, None] - taken) / room, axis=-1), axis=1)
        far = np.abs(spots[:, 1] - np.mean(taken[:, 1]))
        best = np.lexsort([-far, -np.minimum(free, 1.0).round(6) * inside])[0]
        taken = np.vstack([taken, spots[best]])
        look: Any = {"color": group.colour, "weight": "bold", "zorder": 7, "va": "center"}
        look |= {"clip_on": True, "path_effects": [withStroke(linewidth=2.0, foreground="white")]}
        style.write(axes, group.name, to_pixels.inverted().transform(spots[best]), (0, 0), **look)
