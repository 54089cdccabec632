"""A plan as a row of panels: the moments that matter, all at one scale, from one direction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.gridspec import SubplotSpec

from hitchopt.hitch.layout import Layout
from hitchopt.motion.motion import CableState, Motion
from hitchopt.motion.phases import JOINT
from hitchopt.values import Array
from hitchopt.view.house_colours import drone_colours
from hitchopt.view.painter import SPECKS, Camera, Painter
from hitchopt.view.scene import Scene, extent_points, scene_at

MOST = 9
"""Largest number of panels; more would be too small to read."""

FEW = 3
"""Number of panels up to which there is space for another picture below them."""

MANY, BESIDE = 30, 1
"""Number of robots beyond which there is a panel of a few cables, and theirs on either side."""

STEPS = {12: 1, MANY: 2, 100: 4}
"""Step of the painter up to that number of robots: more are fewer pixels wide, and beyond all
SPECKS."""

STILL = 1e-3
"""Distance [m] that some drone is off its place in the panel before; else there is none."""

LONGEST = 1e6
"""Distance [m] beyond all that drones fly, by which some moments come before others."""

AZIMUTH, ELEVATION = -115.0, 38.0
"""Where panels are seen from [deg]."""

THICKNESS = 0.011
"""Radius of a drawn cable as a share of the extent: clasps show over and under in small panels."""

NEAR_WIDTH = 0.5
"""Share of the cables' drawn width that they have in the larger panel of a few cables."""

MARGIN = 0.08
"""Margin around everything as a share of a panel's height."""

SMALL = 0.03
"""Least reach of a drawn drone as a share of a panel's height, while there are few."""

PATH_SAMPLES = 150
"""Number of points of a drone's path."""

PALE = 0.45
"""Opacity of paths."""


@dataclass(frozen=True)
class Shot:
    """A moment that has a panel.

    Attributes
    ----------
    words: above the panel.
    time: from the plan's start [s].
    kept: whether it is shown however many there are, as far as MOST goes.
    near: whether only a few cables are shown, those nearest to the viewer.
    """

    words: str
    time: float
    kept: bool = False
    near: bool = False


def chosen_shots(motion: Motion) -> tuple[Shot, ...]:
    """Return start, swaps, the hitch, the end of whatever moves it, and the plan's end.

    Where there are more than MOST, those with the longest paths before them are chosen.
    """
    shots = [Shot("start", 0.0, kept=True)]
    for _, run in groupby(motion.phases, lambda phase: phase.step):
        phases = list(run)
        for state, same in groupby(phases, lambda phase: phase.state):
            group = list(same)
            if state is CableState.CLASPING:
                middle = 0.5 * (group[0].start + group[0].end)
                shots.append(Shot(group[0].name.rstrip(" 0123456789"), middle, kept=True))
            elif state is CableState.HITCHED and group[-1].name == "tension":
                shots.append(Shot("hitched", group[-1].end, kept=True))
            elif state in (CableState.HITCHED, CableState.NONE):
                moving = [phase for phase in group if phase.name != "relax"]
                shots += [Shot(phase.name, phase.end) for phase in moving]
    shots.append(Shot("end", motion.duration, kept=True))
    times = np.clip([shot.time for shot in shots], 0.0, motion.duration)
    places = motion.drones.at(motion.drones.breaks[0] + times)
    gone = np.max(np.linalg.norm(np.diff(places, axis=0), axis=-1), axis=-1)
    gone = np.concatenate([[np.inf], gone])
    moved = np.flatnonzero(gone > STILL)
    rank = gone[moved] + np.where([shots[i].kept for i in moved], LONGEST, 0.0)
    rank[-1] = np.inf
    shown = np.sort(moved[np.argsort(-rank, kind="stable")[:MOST]])
    chosen = [shots[i] for i in shown]
    if motion.team.robots > MANY:
        hitched = [p for p in motion.phases if p.state is CableState.HITCHED]
        if hitched:
            end = hitched[-1].end
            at = sum(shot.time < end + JOINT for shot in chosen)
            chosen.insert(at, Shot(f"{2 * BESIDE + 1} of the cables", end, near=True))
    return tuple(chosen)


def draw_plan_storyboard(place: SubplotSpec, motion: Motion, shots: Sequence[Shot]) -> list[Axes]:
    """Draw the shots of a plan in a part of a figure; return the panels' axes."""
    times = np.unique([0.0, motion.duration, *(min(s.time, motion.duration) for s in shots)])
    paths = np.linspace(0.0, motion.duration, PATH_SAMPLES)
    paths = np.unique(np.concatenate([paths, times]))
    flown = motion.drones.at(motion.drones.breaks[0] + paths)
    return draw_storyboard(place, scene_at(motion, times, THICKNESS), shots, (paths, flown))


def draw_storyboard(
    place: SubplotSpec, scene: Scene, shots: Sequence[Shot], flown: tuple[Array, Array]
) -> list[Axes]:
    """Draw the panels of a scene; return their axes.

    Parameters
    ----------
    place: part of a figure that they fill.
    scene: samples at which all shots' times are.
    shots: what is shown.
    flown: times (samples,) [s], the shots' among them, and the drones there (samples, drones, 3)
        [m]: the paths.
    """
    columns, rows = _arranged(len(shots))
    grid: Any = place.subgridspec(rows, columns)
    figure = grid.figure
    camera = Camera.toward(AZIMUTH, ELEVATION)
    moments = [int(np.argmin(np.abs(scene.t - shot.time))) for shot in shots]
    seen = camera.seen(extent_points(scene))[moments, :, :2]
    drones = 2 * scene.drones.shape[1]
    middles = 0.5 * (np.min(seen[:, :drones], axis=1) + np.max(seen[:, :drones], axis=1))
    half = np.max(np.abs(seen[:, :drones] - middles[:, None]), axis=(0, 1))
    half = half * (1.0 + 2.0 * MARGIN) + scene.motion.requirements.separation.radius
    size = max(1.0, _smallest(scene) * 2.0 * half[1])
    robots = scene.motion.team.robots
    step = next((step for most, step in STEPS.items() if robots <= most), SPECKS)
    painter = Painter(scene, camera, scene.radius, size, step)
    closer = Painter(scene, camera, NEAR_WIDTH * scene.radius)
    paths = camera.seen(flown[1])[..., :2]
    reached = np.searchsorted(flown[0], scene.t[moments])
    made = []
    for k, (shot, i, middle) in enumerate(zip(shots, moments, middles, strict=True)):
        axes: Any = figure.add_subplot(grid[k // columns, k % columns])
        moment, centre, reach = scene.at(float(scene.t[i])), middle, half
        painting = (closer if shot.near else painter).painted(moment)
        if shot.near:
            centre, reach = _nearest(scene, camera.seen(moment.cables)[..., :2], half)
        before = reached[k - 1] if k and not shot.near else reached[k]
        lines = np.moveaxis(paths[before : reached[k] + 1], 1, 0)
        apart = np.min(np.abs(painting.polygons - centre), axis=1)
        inside = np.all(apart <= reach, axis=1)
        polygons: Any = painting.polygons[inside]
        axes.add_collection(
            LineCollection(
                list(lines), colors=drone_colours(scene.motion.team), linewidths=0.6, alpha=PALE,
                zorder=1,
            ),
            autolim=False,
        )  # fmt: skip
        shapes: Any = PolyCollection(
            polygons, facecolors=painting.colours[inside], linewidths=0.2,
            edgecolors="face", zorder=2,
        )  # fmt: skip
        axes.add_collection(shapes, autolim=False)
        axes.set_aspect("equal")
        axes.set_xlim(centre[0] - reach[0], centre[0] + reach[0])
        axes.set_ylim(centre[1] - reach[1], centre[1] + reach[1])
        axes.xaxis.set_visible(False)
        axes.yaxis.set_visible(False)
        for spine in axes.spines.values():
            spine.set_color("0.85")
        axes.set_title(f"{shot.words}, {shot.time:.1f} s", fontsize="small", parse_math=False)
        made.append(axes)
        if shot.near or k == len(shots) - 1:
            _draw_scale(axes, centre + reach * [1.0, -1.0], reach)
    return made


def _nearest(scene: Scene, cables: Array, half: Array) -> tuple[Array, Array]:
    """Return middle and half sizes (2,) [m] of the panel of the cables nearest to the viewer.

    Parameters
    ----------
    scene: what is shown.
    cables: as seen (n, points, 2) [m].
    half: half sizes of the other panels.
    """
    layout: Layout = scene.motion.team.layout
    first = int(np.argmin(np.min(cables[..., 1], axis=1)))
    beside = np.arange(first - BESIDE, first + BESIDE + 1)
    shown = cables[beside % len(cables) if layout.closed else np.clip(beside, 0, len(cables) - 1)]
    lower, upper = np.min(shown, axis=(0, 1)), np.max(shown, axis=(0, 1))
    scale = (1.0 + 2.0 * MARGIN) * float(np.max(0.5 * (upper - lower) / half))
    return 0.5 * (lower + upper), scale * half


def _arranged(count: int) -> tuple[int, int]:
    """Return columns and rows."""
    columns = 2 if count == 4 else min(count, 3)
    return columns, math.ceil(count / columns)


def _smallest(scene: Scene) -> float:
    """Return the least reach of a drawn drone as a share of a panel's height over the real one."""
    few = min(1.0, 4.0 / math.sqrt(scene.drones.shape[1]))
    return SMALL * few / scene.motion.requirements.separation.radius


def _draw_scale(axes: Axes, corner: Array, half: Array) -> None:
    """Draw a bar of a round length in the lower right corner."""
    length = 10.0 ** math.floor(math.log10(float(half[0])))
    right, up = corner - 0.06 * half[0] * np.array([1.0, -1.0])
    axes.plot([right - length, right], [up, up], color="0.3", linewidth=1.6, zorder=3)
    axes.annotate(
        f"{length:g} m", (right - 0.5 * length, up), (0, 3), textcoords="offset points",
        ha="center", fontsize="x-small", zorder=3,
    )  # fmt: skip
