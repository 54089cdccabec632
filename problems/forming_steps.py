"""Draws the steps of forming of a problem: python -m problems.forming_steps FILE PICTURE."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

import hitchopt as ho
from hitchopt.errors import InputError
from hitchopt.hitch import Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.states import States, states_at
from hitchopt.view.style import COLOURS, INK, marker

Array = NDArray[np.float64]

PATH_COLOUR = "0.72"

RESOLUTION = 130
"""Resolution of the picture [dots per inch]."""

TRAIL = 60
"""Number of samples of a drone's path in one phase."""

PLACES = np.linspace(0.0, 1.0, 81)
"""Points of a cable that are drawn, as shares of its length."""


@dataclass(frozen=True)
class _Panel:
    """A moment, the steps whose paths are drawn with it, and its title."""

    title: str
    phases: tuple[int, ...]  # of STEPS
    share: float  # of the last phase that is over


STEPS = (CableState.CLASPING, CableState.CLASPING, CableState.TIGHTENING, CableState.HITCHED)
"""States of the cables in the steps of forming."""

PANELS = (
    _Panel("1. pre-hitch: cables hang free", (0,), -1.0),
    _Panel("2. first swap: pairs have changed places", (0,), 1.0),
    _Panel("3. second swap, half of it: turning on", (0, 1), 0.5),
    _Panel("tightened, and pulled by the tension", (2, 3), 1.0),
)


def save_forming_steps(path: Path, motion: Motion) -> None:
    """Draw the steps of the first hitch that a plan forms, as a PNG at ``path``.

    Raises
    ------
    InputError: the plan forms none.
    """
    steps = _steps(motion.phases)
    if len(steps) < len(STEPS):
        raise InputError("motion", "no swap", "a plan that forms a hitch", "plan a form step")
    figure = Figure(figsize=(13.0, 3.9), layout="constrained")
    for i, panel in enumerate(PANELS):
        axes = figure.add_subplot(1, len(PANELS), i + 1, projection="3d")
        shown = [steps[i] for i in panel.phases]
        last = shown[-1]
        time = last.start + max(panel.share, 0.0) * (last.end - last.start)
        _draw(axes, motion, time, shown if panel.share > 0.0 else [])
        axes.set_title(panel.title, fontsize="medium", y=1.0)
    figure.legend(handles=_legend(), loc="lower center", ncols=4, frameon=False, fontsize="small")
    figure.savefig(path, format="png", dpi=RESOLUTION, metadata={"Software": None})


def _steps(phases: Sequence[Phase]) -> list[Phase]:
    """Return the first phases that are in the states of STEPS one after the other, or fewer."""
    found: list[Phase] = []
    for phase in phases:
        if len(found) == len(STEPS):
            break
        if phase.state == STEPS[len(found)]:
            found.append(phase)
        elif found and phase.state != found[-1].state:
            found = []  # a swap that undoes a hitch leads to free cables
    return found


def _draw(axes: Any, motion: Motion, time: float, phases: list[Phase]) -> None:
    """Draw drones and cables at ``time`` and the paths of all drones in ``phases``."""
    # Just before the end, which belongs to the piece before it.
    state = states_at(motion, max(time - 1e-9, 0.0))
    for phase in phases:
        paths = states_at(motion, np.linspace(phase.start, phase.end, TRAIL)).positions
        for drone in range(paths.shape[1]):
            axes.plot(*paths[:, drone].T, color=PATH_COLOUR, linewidth=1.2)
    for k, points in enumerate(_cables(motion.team, state)):
        axes.plot(*points.T, color=COLOURS[k % len(COLOURS)], linewidth=2.0)
    for first, shape, fill in ((0, "o", INK), (1, "s", "white")):
        axes.plot(
            *state.positions[first::2].T, linestyle="none", marker=shape, markersize=5.0,
            markerfacecolor=fill, markeredgecolor=INK,
        )  # fmt: skip
    _frame(axes, motion)


def _cables(team: Team, state: States) -> list[Array]:
    """Return the points of every cable, taut or hanging."""
    pairs = state.positions.reshape(-1, 2, 3)
    if state.formed:
        layout, vertices = team.layout, state.vertices
        corners = [pairs[:, 0], vertices[layout.starts], vertices[layout.ends], pairs[:, 1]]
        return list(np.stack(corners, axis=1))
    q, r = pairs[:, 0], pairs[:, 1]
    cables = Catenary.between(q, r, team.cable_length)
    mu = cables.parameter(PLACES[:, None])
    points = q + (0.5 * (1.0 + mu))[..., None] * (r - q)
    points[..., 2] -= cables.depth(mu)
    return list(np.swapaxes(points, 0, 1))


def _frame(axes: Any, motion: Motion) -> None:
    """Give all panels the same limits: those of the hitch and of the cables below it."""
    formed = motion.spans(lambda state: state.hitched)[0]
    places = formed.drones.coefficients[0, ..., 0]
    middle = np.mean(places, axis=0)
    reach = 1.02 * float(np.max(np.linalg.norm(places - middle, axis=1)))
    depth = 0.5 * float(np.max(motion.team.cable_length))
    axes.set_xlim(middle[0] - reach, middle[0] + reach)
    axes.set_ylim(middle[1] - reach, middle[1] + reach)
    axes.set_zlim(middle[2] - depth, middle[2] + 0.5)
    axes.view_init(elev=38.0, azim=-75.0)
    axes.set_box_aspect((2.0 * reach, 2.0 * reach, depth + 0.5), zoom=1.4)
    axes.set_axis_off()


def _legend() -> list[Line2D]:
    return [
        Line2D([], [], color=COLOURS[0], linewidth=2.0, label="cables, one colour each"),
        marker("o", INK, INK, "drones q"),
        marker("s", "white", INK, "drones r"),
        Line2D([], [], color=PATH_COLOUR, label="drones' paths"),
    ]


def main(file: str, picture: str) -> None:
    """Plan the problem in ``file`` and draw its steps of forming."""
    motion = ho.solve(file).motion
    if not motion.team.has_cables:
        raise SystemExit(f"{file}: forms no hitch")
    save_forming_steps(Path(picture), motion)


if __name__ == "__main__":
    main(*sys.argv[1:])
