"""Evaluation of a recorded flight: vertices and drones over time, against its plan."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hitchopt.errors import FileError, InputError, OneLine, UnsupportedError
from hitchopt.flights.alignment import Alignment, align
from hitchopt.flights.readers import read_flight
from hitchopt.flights.recordings import (
    WINDOW_TIGHT,
    RecordedFlight,
    Recording,
    Track,
    planned,
    tight,
)
from hitchopt.flights.vertices import RATE, WINDOW, Measured, clasps_of, measured_vertices
from hitchopt.geometry.vectors import length
from hitchopt.motion.motion import Motion
from hitchopt.plan import Plan
from hitchopt.simulation.task import Task, read_task
from hitchopt.values import Array, finite, nonnegative, path, positive, text

if TYPE_CHECKING:
    from pandas import DataFrame

LONGEST_WINDOW = 1.0  # Largest time over which places are averaged [s]
MIN_SHARE = 0.5  # Share of the time below which a remark says why a vertex is missing
ROUNDING = 1e-6  # Of times over their step


@dataclass(frozen=True)
class Row:
    """Errors of a vertex or a drone in a phase, or in all of the flight.

    Attributes
    ----------
    name: of the vertex or drone, or ``vertices``: all of them.
    phase, start, end: its name, and times [s]; ``all``: the whole flight.
    mean, std, max: of the distances from the plan in three dimensions [m]; nan without samples.
    found: share of the samples in which it was measured.
    standard_error: median of those of the positions [m]; nan for drones.
    """

    name: str
    phase: str
    start: float
    end: float
    mean: float
    std: float
    max: float
    found: float
    standard_error: float


@dataclass(frozen=True, eq=False)
class Evaluation(OneLine):
    """A recorded flight in the plan's time and frame, at 20 Hz.

    Attributes
    ----------
    task: the plan of the flight.
    flight: the recording.
    alignment: clock, frame and names.
    t: (times,) [s], from the plan's start, as far as it was recorded.
    vertices: crossings of the cables (times, points, 3) [m]; nan if not measured.
    clasps: contacts of cables of the stated diameter; None without one.
    planned: vertices of the plan (times, points, 3) [m]; nan while its hitch is not drawn tight.
    standard_errors: of the vertices (times, points) [m].
    drones: (times, 2n, 3) [m], nan if not visible.
    planned_drones: (times, 2n, 3) [m], their set points.
    density: of every cable (n,) [kg/m], as stated, planned or fitted.
    cloud: markers while the plan has its hitch.
    remarks: fitted quantities, corrections, and reasons of missing vertices.
    """

    task: Task
    flight: RecordedFlight
    alignment: Alignment
    t: Array
    vertices: Array
    clasps: Array | None
    planned: Array
    standard_errors: Array
    drones: Array
    planned_drones: Array
    density: Array
    cloud: Track
    remarks: tuple[str, ...]

    @property
    def measured(self) -> Array:
        """The clasps, or else the crossings (times, points, 3) [m]."""
        return self.vertices if self.clasps is None else self.clasps

    @property
    def errors(self) -> Array:
        """(times, points) [m]: distances of the clasps, or else the crossings, from the plan."""
        return length(self.measured - self.planned)

    @property
    def drone_errors(self) -> Array:
        """(times, 2n) [m]: distances of the drones from their set points."""
        return length(self.drones - self.planned_drones)

    @property
    def motion(self) -> Motion:
        """The plan; InputError for a task of set points alone."""
        if self.task.motion is None:
            raise InputError("plan", "set points", "a plan", "read it with read_task")
        return self.task.motion

    @property
    def table(self) -> tuple[Row, ...]:
        """Errors of every vertex and all of them, and of every drone, by phase and in all."""
        team, t, rows = self.task.team, self.t, list[Row]()
        points, off, stated = team.layout.clasps, self.errors, self.standard_errors
        hitched, none = np.isfinite(self.planned[:, points[0], 0]), np.full(len(t), np.nan)
        columns = [(team.point_names[p], hitched, off[:, p], stated[:, p]) for p in points]
        columns.append(("vertices", hitched, off[:, points], stated[:, points]))
        drones = zip(team.drone_names, self.drone_errors.T, strict=True)
        columns += [(name, t >= 0.0, each, none) for name, each in drones]
        spans = [(phase.name, phase.start, phase.end) for phase in self.motion.phases]
        for span in [*spans, ("all", float(t[0]), float(t[-1]))]:
            during = (t >= span[1]) & ((t < span[2]) | (span[0] == "all"))
            for name, use, each, error in columns:
                if np.any(here := use & during):
                    x, known = (y[here][np.isfinite(y[here])] for y in (each, error))
                    values: Any = (x.mean(), x.std(), x.max()) if x.size else (np.nan,) * 3
                    values += x.size / each[here].size, np.median(known) if known.size else np.nan
                    rows.append(Row(name, *span, *map(float, values)))
        return tuple(rows)

    @property
    def short_table(self) -> tuple[Row, ...]:
        """The table without the drones' rows of single phases."""
        drones = self.task.team.drone_names
        return tuple(row for row in self.table if row.phase == "all" or row.name not in drones)

    def to_dataframe(self) -> DataFrame:
        """Return the table as a pandas data frame; UnsupportedError without pandas."""
        try:
            import pandas
        except ImportError as error:
            words = f"data frames need pandas ({error}); pip install 'hitchopt[pandas]'"
            raise UnsupportedError(words) from error
        return pandas.DataFrame([asdict(row) for row in self.table])

    def to_recording(self) -> Recording:
        """Return the recording in the plan's time and frame, for ``calibrate``."""
        layout = self.task.team.layout
        vertices = self.measured.copy()
        ends = np.flatnonzero(~layout.has_leg.ravel())  # Drones that are a chain's points
        vertices[:, layout.anchors[ends]] = self.drones[:, ends]
        facts: Any = dict(self.flight.simulated)
        facts |= {"standard_errors": self.standard_errors, "notes": self.remarks}
        return Recording(self.t, self.drones, vertices, **facts)

    def save(self, directory: Path | str, format: str = "png") -> Path:
        """Write table, vertices, picture and shapes to a directory; return it.

        The picture is ``evaluation.png``, or ``svg`` or ``pdf``. Raises FileError if the directory
        cannot be written to, or holds a plan or a simulation.
        """
        from hitchopt.flights.report import save_evaluation

        return save_evaluation(path("directory", directory), self, text("format", format))


def evaluate(
    recording: RecordedFlight | Path | str,
    plan: Task | Plan | Path | str,
    *,
    names: Mapping[str, str] | str | None = None,
    frame: str | Path | None = None,
    start: float | None = None,
    unit: str | None = None,
    density: float | None = None,
    diameter: float | None = None,
    window: float = WINDOW,
) -> Evaluation:
    """Compare a recorded flight with its plan: clock, frame and names, then vertices and drones.

    Parameters
    ----------
    recording: a file or directory in a format of ``read_flight``, or the flight that it returns.
    plan: the plan of the flight, or its directory.
    names: drones by recorded names, such as ``cf231=q0,cf7=r0``; None: by their positions.
    frame: ``plan``, ``y-up``, ``fit``, or a JSON file with rotation and shift, such as another
        evaluation; None: the plan's or y-up if drones are then near their plan, else fitted.
    start: time of the recording at which the plan begins [s]; None: fitted, or 0 of a simulation.
    unit: of the recording's lengths, if the file does not state it.
    density: of the cables [kg/m]; None: the plan's, or fitted if the plan knows no weight.
    diameter: of the cables [m]; with it, errors are those of their clasps, not their crossings.
    window: time over which markers are averaged [s].

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
    if positive("window", window) > LONGEST_WINDOW:
        raise InputError("window", window, f"at most {LONGEST_WINDOW:g} s", "0.1 is usual")
    if isinstance(names, str):
        pairs = names.replace(" ", "").split(",")
        names = {name: drone for name, _, drone in (pair.partition("=") for pair in pairs)}
    flight, stated = recording, None if frame is None else str(frame)
    if not isinstance(flight, RecordedFlight):
        flight = read_flight(path("recording", flight), unit)
    if isinstance(plan, Plan):
        task = Task.of(plan.motion)
    else:
        task = plan if isinstance(plan, Task) else read_task(path("plan", plan))
    task.refuse_several("evaluate")
    if flight.simulated and start is None:
        start = 0.0  # Its clock is the plan's
    try:
        alignment = align(flight, task, names=names, frame=stated, start=start)
    except FileError as error:
        place = flight.source if flight is recording else f"{recording}: {flight.source}"
        raise FileError(f"{place}: {error}") from None
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

    def at(times: Array, track: Track, offset: float, *, through_gaps: bool = False) -> Array:
        """Return positions of a body at plan times (times, 3) [m]; nan in gaps."""
        positions, near = track.at((times - offset) / rate)
        return alignment.placed(np.where(near[:, None] | through_gaps, positions, np.nan))

    hitched = tight(task, t, WINDOW_TIGHT)
    vertices = np.full((len(t), layout.points, 3), np.nan)
    errors = np.full(vertices.shape[:2], np.nan)
    densities = np.full(team.robots, team.cable_density if density is None else density)
    remarks = [*flight.notes, *_remarks(alignment, flight)]
    seen = rate * flight.markers.t + alignment.offset
    use = (seen >= 0.0) & (seen <= task.duration) & tight(task, seen, WINDOW_TIGHT)
    cloud = Track(seen[use], alignment.placed(flight.markers.positions[use]))
    named = [name for name in team.point_names if name in flight.tracks]
    for name in named:
        point = at(t, flight.tracks[name], alignment.offset)
        vertices[hitched, team.point_names.index(name)] = point[hitched]
    if not named and len(cloud.t) and np.any(hitched):
        frames = np.unique(cloud.t)
        drones = np.stack([at(frames, *each, through_gaps=True) for each in clocks], axis=1)
        measured = measured_vertices(task, t[hitched], cloud, drones, density, window)
        vertices[hitched] = measured.crossings
        errors[hitched] = np.hypot(measured.standard_errors, alignment.frame_error)
        remarks += _missing(measured, task)
        if not np.allclose(measured.density, densities):
            fitted = ", ".join(f"{1e3 * x:.1f}" for x in measured.density)
            remarks.append(f"cables' density is fitted, {fitted} g/m: weigh them for density=")
        densities = measured.density
    elif not named:
        remarks.append("no markers on the cables: drones alone are compared with the plan")
    expected = planned(task, t, task.vertices)
    expected[~hitched] = np.nan
    contacts = None if diameter is None else clasps_of(vertices, layout, diameter)
    places = np.stack([at(t, *each) for each in clocks], axis=1)
    of_drones = places, planned(task, t, task.setpoints.positions)
    more: Any = (errors, *of_drones, densities, cloud, tuple(dict.fromkeys(remarks)))
    return Evaluation(task, flight, alignment, t, vertices, contacts, expected, *more)


def _remarks(alignment: Alignment, flight: RecordedFlight) -> Iterator[str]:
    """Yield the fitted quantities of clock and frame."""
    shared = "that all drones share is part of it"
    if "clock" in alignment.fitted and not flight.setpoints:
        yield f"the clock is fitted ± {1e3 * alignment.offset_error:.0f} ms; a lag {shared}"
    if "rate" in alignment.fitted:
        yield f"the recording's clock runs at {alignment.rate:.5f} of the plan's"
    if alignment.frame == "y-up":
        yield "y is upright in the recording"
    if "frame" in alignment.fitted:
        yield f"the frame is fitted: a displacement {shared}"


def _missing(measured: Measured, task: Task) -> Iterator[str]:
    """Yield why vertices are missing."""
    layout, seen = task.team.layout, measured.markers
    for a, point, b in zip(layout.behind, layout.clasps, layout.ahead, strict=True):
        share = float(np.mean(np.isfinite(measured.crossings[:, point, 0])))
        if share < MIN_SHARE:
            yield (
                f"{task.team.point_names[point]} is found {share:.0%} of the time: markers seen at "
                f"once are {seen[a]:.1f} on edge {a} and {seen[b]:.1f} on edge {b}; two are "
                "needed, some decimetres apart"
            )
