"""Compare a recorded flight with its plan: vertices and drones over time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError, InputError
from hitchopt.lab.flights.alignment import Alignment, align
from hitchopt.lab.flights.evaluation import Evaluation
from hitchopt.lab.flights.readers import read_flight
from hitchopt.lab.flights.recordings import RecordedFlight, Track, plan_at, taut_at
from hitchopt.lab.flights.vertices import RATE, WINDOW, Measured, clasps_of, measured_vertices
from hitchopt.lab.simulation.task import Task, read_task
from hitchopt.plan import Plan
from hitchopt.values import Array, finite, nonnegative, path, positive

MAX_WINDOW = 1.0  # Largest time window of line fits [s]
MIN_SHARE = 0.5  # Smallest share of the time of a vertex that is measured without a remark
ROUNDING = 1e-6  # Tolerance of a number of time steps


def evaluate(
    recording: RecordedFlight | Path | str,
    plan: Task | Plan | Path | str,
    *,
    names: Mapping[str, str] | str | None = None,
    frame: str | Path | None = None,
    start: float | None = None,
    unit: str | None = None,
    topic: str | None = None,
    density: float | None = None,
    diameter: float | None = None,
    window: float = WINDOW,
) -> Evaluation:
    """Align a recorded flight with its plan, and compare vertices and drones.

    Parameters
    ----------
    recording: a file or directory in a format of ``read_flight``, or a ``RecordedFlight``.
    plan: the plan of the flight, or its directory.
    names: drones by recorded names, such as ``cf231=q0,cf7=r0``; None: assigned by positions.
    frame: ``plan``, ``y-up``, ``fit``, or a JSON file with rotation and shift, such as another
        evaluation; None: the plan's or y-up if drones are then near their plan, else fitted.
    start: time of the recording at which the plan begins [s]; None: fitted, or 0 for a simulation.
    unit: of the recording's lengths, if the file does not state it.
    topic: topic of a bag or a log with the drones' positions; see ``read_flight``.
    density: of the cables [kg/m]; None: the plan's, or fitted if the plan models no weight.
    diameter: of the cables [m]; if given, errors are those of clasps instead of crossings.
    window: time window of the line fits [s].

    Raises
    ------
    FileError: a recording that cannot be read, or is of another plan.
    InputError: an argument outside its bounds.
    """
    if density is not None:
        density = nonnegative("density", density)
    if diameter is not None:
        diameter = positive("diameter", diameter)
    if start is not None:
        start = finite("start", start)
    if positive("window", window) > MAX_WINDOW:
        raise InputError("window", window, f"at most {MAX_WINDOW:g} s", "0.1 is usual")
    if isinstance(names, str):
        pairs = names.replace(" ", "").split(",")
        names = {name: drone for name, _, drone in (pair.partition("=") for pair in pairs)}
    flight, frame_name = recording, None if frame is None else str(frame)
    if not isinstance(flight, RecordedFlight):
        flight = read_flight(path("recording", flight), unit, topic)
    elif unit is not None or topic is not None:
        raise InputError("unit, topic", (unit, topic), "left out", "the recording is read already")
    if isinstance(plan, Plan):
        task = Task.of(plan.motion)
    else:
        task = plan if isinstance(plan, Task) else read_task(path("plan", plan))
    task.require_one_team("evaluate")
    if flight.simulated and start is None:
        start = 0.0  # The clock of a simulation is the plan's
    try:
        alignment = align(flight, task, names=names, frame=frame_name, start=start)
    except FileError as error:
        source = flight.source if flight is recording else f"{recording}: {flight.source}"
        raise FileError(f"{source}: {error}") from None
    return _evaluated(flight, task, alignment, density, diameter, window)


def _evaluated(
    flight: RecordedFlight,
    task: Task,
    alignment: Alignment,
    density: Any,
    diameter: Any,
    window: float,
) -> Evaluation:
    """Return the evaluation of an aligned flight."""
    team, layout, rate = task.team, task.team.layout, alignment.rate
    tracks = [flight.tracks[name] for name in alignment.names]
    clocks = list(zip(tracks, alignment.offsets.tolist(), strict=True))
    ends = [rate * track.t[[0, -1]] + offset for track, offset in clocks]
    first = np.ceil(RATE * max(0.0, np.min(ends)) - ROUNDING)
    last = np.floor(RATE * min(task.duration, np.max(ends)) + ROUNDING)
    t = np.arange(first, last + 1.0) / RATE + 0.0  # No negative zero

    def at(times: Array, track: Track, offset: float, *, interpolated: bool = False) -> Array:
        """Return positions of a body at plan times (times, 3) [m]; nan where it is not visible."""
        positions, visible = track.at((times - offset) / rate)
        return alignment.placed(np.where(visible[:, None] | interpolated, positions, np.nan))

    hitched = taut_at(task, t)
    vertices = np.full((len(t), layout.points, 3), np.nan)
    errors = np.full(vertices.shape[:2], np.nan)
    densities = np.full(team.robots, team.cable_density if density is None else density)
    remarks = [*flight.notes, *_remarks(alignment, flight)]
    times = rate * flight.markers.t + alignment.offset
    taut = (times >= 0.0) & (times <= task.duration) & taut_at(task, times)
    cloud = Track(times[taut], alignment.placed(flight.markers.positions[taut]))
    recorded_points = [name for name in team.point_names if name in flight.tracks]
    for name in recorded_points:
        point = at(t, flight.tracks[name], alignment.offset)
        vertices[hitched, team.point_names.index(name)] = point[hitched]
    if not recorded_points and len(cloud.t) and np.any(hitched):
        frames = np.unique(cloud.t)
        drones = np.stack([at(frames, *each, interpolated=True) for each in clocks], axis=1)
        measured = measured_vertices(task, t[hitched], cloud, drones, density, window)
        vertices[hitched] = measured.crossings
        errors[hitched] = np.hypot(measured.standard_errors, alignment.frame_error)
        remarks += _missing(measured, task)
        if not np.allclose(measured.density, densities):
            fitted = ", ".join(f"{1e3 * x:.1f}" for x in measured.density)
            remarks.append(f"cables' density is fitted, {fitted} g/m: weigh them for density=")
        densities = measured.density
    elif not recorded_points:
        remarks.append("no markers on the cables: only drones are compared with the plan")
    expected = plan_at(task, t, task.states.vertices)
    expected[~hitched] = np.nan
    contacts = None if diameter is None else clasps_of(vertices, layout, diameter)
    positions = np.stack([at(t, *each) for each in clocks], axis=1)
    drone_positions = positions, plan_at(task, t, task.states.positions)
    rest: Any = (errors, *drone_positions, densities, cloud, tuple(dict.fromkeys(remarks)))
    return Evaluation(task, flight, alignment, t, vertices, contacts, expected, *rest)


def _remarks(alignment: Alignment, flight: RecordedFlight) -> Iterator[str]:
    """Yield remarks on clock and frame."""
    shared = "common to all drones is absorbed"
    if "clock" in alignment.fitted and (flight.as_sent or not flight.setpoints):
        yield f"the clock is fitted ± {1e3 * alignment.offset_error:.0f} ms; a lag {shared}"
    if "rate" in alignment.fitted:
        yield f"the plan advances by {alignment.rate:.5f} s per second of the recording"
    if alignment.frame == "y-up":
        yield "the recording's frame is y-up"
    if "frame" in alignment.fitted:
        lift = 1e3 * alignment.shift[2]
        heights = f"shifted by {lift:+.0f} mm" if lift else "as recorded"
        yield f"the frame is fitted: a displacement {shared}; heights are {heights}"


def _missing(measured: Measured, task: Task) -> Iterator[str]:
    """Yield reasons for missing vertices."""
    layout, markers = task.team.layout, measured.markers
    for a, point, b in zip(layout.behind, layout.clasps, layout.ahead, strict=True):
        share = float(np.mean(np.isfinite(measured.crossings[:, point, 0])))
        if share < MIN_SHARE:
            visible = f"{markers[a]:.1f} markers on edge {a} and {markers[b]:.1f} on edge {b}"
            yield (
                f"{task.team.point_names[point]} is measured {share:.0%} of the time: on average "
                f"{visible} are visible; two are needed, some decimetres from each other"
            )
