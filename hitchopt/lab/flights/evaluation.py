"""Compare a recorded flight with its plan: vertices and drones over time, files and a picture."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hitchopt.errors import FileError, InputError, OneLine, optional_module
from hitchopt.geometry.vectors import length
from hitchopt.lab.flights.alignment import Alignment, align
from hitchopt.lab.flights.readers import read_flight
from hitchopt.lab.flights.recordings import (
    RecordedFlight,
    Recording,
    Track,
    drones_by_name,
    plan_at,
    taut_at,
)
from hitchopt.lab.flights.vertices import (
    RATE,
    WINDOW,
    Measured,
    clasps_of,
    measured_vertices,
    through_gaps,
)
from hitchopt.lab.simulation.exported import team_task
from hitchopt.lab.simulation.task import TeamTask
from hitchopt.motion.flight import Flight
from hitchopt.plan import Plan
from hitchopt.storage.archive import PLAN, RECORDING
from hitchopt.storage.files import Writer, replace_files, write_strict_json
from hitchopt.support import Feature
from hitchopt.values import Array, check_choice, finite, nonnegative, path, positive, text
from hitchopt.values.fields import suggest_keywords
from hitchopt.view import style
from hitchopt.view.cables import CLASPS, POINTS
from hitchopt.view.scene import scene_at

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

MAX_WINDOW = 1.0  # Largest time window of line fits [s]
MIN_SHARE = 0.5  # Smallest fraction of the time of a vertex that is measured without a remark
ROUNDING = 1e-6  # Tolerance of a number of time steps

FORMAT = "hitchopt-evaluation/1"
SUMMARY = "evaluation.json"  # Figures of the evaluation
VERTICES = "vertices.csv"  # Measured vertices
LATEX = "evaluation.tex"  # Table in LaTeX
PICTURE = "evaluation."  # Name of the picture, without suffix
FOREIGN = (PLAN, "simulation.json")  # Files of directories with another vertices.csv
PICTURES = ("png", "svg", "pdf")  # Picture formats
# Files in the directory that hitchopt replaces; others are never touched
OWNED = (SUMMARY, VERTICES, LATEX, RECORDING, *(PICTURE + kind for kind in PICTURES))

SIZE = (13.0, 6.4)  # Width and height of the picture [inch]
WIDTHS = (1.35, 1.0)  # Widths of its columns, relative
PAGE_SHARES = (0.6, 0.5, 0.8)  # Heights of the parts on a page, as fractions of its width
PAGE_LEGEND = 0.9  # Height of the legend on a page [inch]
MAX_NAMED = 8  # Maximum number of names in a legend
MOVING_SPEED = 1e-3  # Planned speed of a drone from which the flight is in motion [m/s]
SNAPSHOT_TIME = 0.05  # Half width of a snapshot [s]


@dataclass(frozen=True)
class ErrorRow:
    """Errors of a vertex or a drone in a phase or in the whole flight."""

    name: str  # of the vertex or drone, or ``vertices`` for all vertices
    phase: str  # name, ``moving`` or ``resting`` for all such times, ``all`` for the whole flight
    start: float  # [s]
    end: float  # [s]
    mean: float  # distance from the plan in three dimensions [m]; nan without samples
    std: float  # standard deviation of these distances [m]
    max: float  # largest distance [m]
    found: float  # fraction of the samples in which it was measured
    standard_error: float  # median standard error of the positions [m]; nan for drones


@dataclass(frozen=True, eq=False)
class Evaluation(OneLine):
    """A recorded flight in the plan's time and frame, at 20 Hz.

    Attributes
    ----------
    task: the plan of the flight.
    flight: the recording.
    alignment: clock, frame and names.
    t: (times,) [s] from the plan's start, while the plan was recorded.
    vertices: crossings of the cables (times, points, 3) [m]; nan if not measured.
    clasps: contacts of cables of the stated diameter (times, points, 3) [m]; None without one.
    planned: vertices of the plan (times, points, 3) [m]; nan while its hitch is not taut.
    standard_errors: of the vertices (times, points) [m].
    drones: (times, 2n, 3) [m], nan if not visible.
    planned_drones: (times, 2n, 3) [m], planned setpoints.
    density: of every cable (n,) [kg/m], stated, planned or fitted.
    cloud: markers while the plan's hitch is taut.
    remarks: fitted quantities, corrections, and reasons for missing vertices.
    """

    task: TeamTask
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
        """Clasps, or crossings if no diameter is given, (times, points, 3) [m]."""
        return self.vertices if self.clasps is None else self.clasps

    @property
    def errors(self) -> Array:
        """Distances of ``measured`` from the planned vertices (times, points) [m]."""
        return length(self.measured - self.planned)

    @property
    def sag(self) -> str:
        """Statement on whether vertex errors include the cables' sag."""
        if self.task.team.cable_density > 0.0:
            weight = f"{1e3 * self.task.team.cable_density:g} g/m"
            return f"the sag of cables of {weight} is planned: these errors do not include it"
        return "the plan ignores the cables' weight: these errors include sag"

    @property
    def drone_errors(self) -> Array:
        """Distances of the drones from their setpoints (times, 2n) [m]."""
        return length(self.drones - self.planned_drones)

    @property
    def planned_flight(self) -> Flight:
        """The plan; InputError for a task without one."""
        flight = self.task.flight
        if flight is None:
            raise InputError("plan", "setpoints", "a plan", "pass the plan or its directory")
        return flight

    @property
    def table(self) -> tuple[ErrorRow, ...]:
        """Errors of every vertex, of all vertices and of every drone, by phase and overall.

        The flight is moving while any drone has a planned speed.
        """
        team = self.task.team
        t = self.t
        rows = list[ErrorRow]()
        points = team.layout.clasps
        off = self.errors
        stated = self.standard_errors
        hitched = np.isfinite(self.planned[:, points[0], 0])
        missing = np.full(len(t), np.nan)
        columns = [(team.point_names[p], hitched, off[:, p], stated[:, p]) for p in points]
        columns.append(("vertices", hitched, off[:, points], stated[:, points]))
        drones = zip(team.listed_names, self.drone_errors.T[team.listed], strict=True)
        columns += [(name, t >= 0.0, each, missing) for name, each in drones]
        velocities = np.gradient(self.planned_drones, t, axis=0) if len(t) > 1 else 0.0
        moving = (
            np.max(length(velocities + np.zeros_like(self.planned_drones)), axis=1) > MOVING_SPEED
        )
        flight = float(t[0]), float(t[-1])
        spans = [
            *(
                ((phase.name, phase.start, phase.end), (t >= phase.start) & (t < phase.end))
                for phase in self.planned_flight.phases
            ),
            (("moving", *flight), moving),
            (("resting", *flight), ~moving),
            (("all", *flight), np.ones_like(moving)),
        ]
        for span, during in spans:
            for name, mask, each, error in columns:
                if np.any(chosen := mask & during):
                    x, e = (y[chosen][np.isfinite(y[chosen])] for y in (each, error))
                    values: Any = (x.mean(), x.std(), x.max()) if x.size else (np.nan,) * 3
                    values += x.size / each[chosen].size, np.median(e) if e.size else np.nan
                    rows.append(ErrorRow(name, *span, *map(float, values)))
        return tuple(rows)

    @property
    def short_table(self) -> tuple[ErrorRow, ...]:
        """The table without rows of drones in single phases."""
        drones = self.task.team.drone_names
        return tuple(row for row in self.table if row.phase == "all" or row.name not in drones)

    def to_dataframe(self) -> DataFrame:
        """Return the table as a pandas data frame; UnsupportedError without pandas."""
        pandas = optional_module("pandas", "data frames need", "pandas")
        frame: DataFrame = pandas.DataFrame([asdict(row) for row in self.table])
        return frame

    def to_recording(self) -> Recording:
        """Return the recording in the plan's time and frame, for ``calibrate``."""
        layout = self.task.team.layout
        vertices = self.measured.copy()
        ends = np.flatnonzero(~layout.has_leg.ravel())  # Drones at the ends of a chain
        vertices[:, layout.anchors[ends]] = self.drones[:, ends]
        fields: Any = dict(self.flight.simulated)
        fields |= {"standard_errors": self.standard_errors, "notes": self.remarks}
        return Recording(self.t, self.drones, vertices, **fields)

    def save(self, directory: Path | str, format: str = "png", width: float | None = None) -> Path:
        """Write the table, vertices, picture and shapes to a directory; return its path.

        The picture is ``evaluation.png``, or ``svg`` or ``pdf``; with a ``width`` [inch] it is a
        figure for a paper with text of 8 pt. All files are written, or none.

        Raises
        ------
        FileError: the directory cannot be written to, or holds a plan or a simulation.
        InputError: an unknown format.
        """
        directory, kind = path("directory", directory), text("format", format)
        check_choice("format", kind, PICTURES)
        for name in FOREIGN:
            if (directory / name).exists():
                problem = f"contains {name}; name a separate directory for results"
                raise FileError(f"{directory}: {problem}")
        picture = drawn_evaluation(self, width)
        writers: dict[str, Writer] = {
            VERTICES: partial(_write_vertices, self),
            LATEX: lambda path: path.write_text(latex_table(self), "utf-8", newline="\n"),
            RECORDING: lambda path: np.savez_compressed(path, **shapes(self)),  # type: ignore[arg-type]
            PICTURE + kind: lambda path: style.save_figure(picture, path),
            SUMMARY: lambda path: write_strict_json(path, summary(self)),
        }
        return replace_files(directory, writers, OWNED, seal=SUMMARY)


@suggest_keywords
def evaluate(
    recording: RecordedFlight | Path | str,
    plan: TeamTask | Plan | Path | str,
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
    plan: the plan of the flight, its directory, or the folder of the export that was flown.
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
    FileError: a recording that cannot be read, or belongs to another plan.
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
    flight = recording
    frame_name = None if frame is None else str(frame)
    if not isinstance(flight, RecordedFlight):
        flight = read_flight(path("recording", flight), unit, topic)
    elif unit is not None or topic is not None:
        raise InputError("unit, topic", (unit, topic), "omitted", "the recording is read already")
    task = team_task(plan, Feature.EVALUATE)
    if flight.simulated and start is None:
        start = 0.0  # The clock of a simulation is the plan's
    try:
        alignment = align(flight, task, names=drones_by_name(names), frame=frame_name, start=start)
    except FileError as error:
        source = flight.source if flight is recording else f"{recording}: {flight.source}"
        raise FileError(f"{source}: {error}") from None
    return _evaluated(flight, task, alignment, density, diameter, window)


def _evaluated(
    flight: RecordedFlight,
    task: TeamTask,
    alignment: Alignment,
    density: Any,
    diameter: Any,
    window: float,
) -> Evaluation:
    """Return the evaluation of an aligned flight."""
    team = task.team
    layout = task.team.layout
    rate = alignment.rate
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
            remarks.append(
                f"the cables' density is fitted, {fitted} g/m: weigh the cables, and pass density="
            )
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


def _missing(measured: Measured, task: TeamTask) -> Iterator[str]:
    """Yield reasons for missing vertices."""
    layout = task.team.layout
    markers = measured.markers
    for a, point, b in zip(layout.behind, layout.clasps, layout.ahead, strict=True):
        share = float(np.mean(np.isfinite(measured.crossings[:, point, 0])))
        if share < MIN_SHARE:
            visible = f"{markers[a]:.1f} markers on edge {a} and {markers[b]:.1f} on edge {b}"
            yield (
                f"{task.team.point_names[point]} is measured {share:.0%} of the time: on average "
                f"{visible} are visible; two are needed, a few decimetres apart"
            )


def summary(evaluation: Evaluation) -> dict[str, Any]:
    """Return alignment, remarks and table, ready for JSON."""
    each = {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in vars(evaluation.alignment).items()
    }
    return {
        "format": FORMAT,
        "source": evaluation.flight.source,
        "recorded": evaluation.t[[0, -1]].tolist(),
        "alignment": {"offset": evaluation.alignment.offset, **each},
        "errors_of": "crossings" if evaluation.clasps is None else "clasps",
        "sag": evaluation.sag,
        "density": evaluation.density.tolist(),
        "remarks": list(evaluation.remarks),
        "table": [asdict(row) for row in evaluation.table],
    }


def _write_vertices(evaluation: Evaluation, path: Path) -> None:
    """Write a row per vertex and time at which the plan's hitch is taut."""
    from hitchopt.lab.simulation.report import write_table  # heavy

    points = evaluation.task.team.layout.clasps
    taut = np.isfinite(evaluation.planned[:, points[0], 0])
    columns = {"x,y,z": evaluation.vertices, "planned_x,planned_y,planned_z": evaluation.planned}
    columns |= {"error": evaluation.errors, "standard_error": evaluation.standard_errors}
    if evaluation.clasps is not None:
        columns["clasp_x,clasp_y,clasp_z"] = evaluation.clasps
    written = {name: values[taut][:, points] for name, values in columns.items()}
    write_table("vertex", points, evaluation.t[taut], written, path)


def shapes(evaluation: Evaluation) -> dict[str, Array]:
    """Return the cables over time for a ghost in the viewer.

    Shapes are the plan's, displaced with the measured drones and vertices.
    """
    t = evaluation.t
    task = evaluation.task
    layout = evaluation.task.team.layout
    scene = scene_at(evaluation.planned_flight, np.clip(t, 0.0, task.duration))
    displacements, ends = (
        np.nan_to_num(through_gaps(t, off, t))
        for off in (
            evaluation.measured - evaluation.planned,
            evaluation.drones - evaluation.planned_drones,
        )
    )
    ends = ends.reshape(len(t), -1, 2, 3)
    knots = np.stack([np.interp(range(4), (0, 3), one) for one in np.eye(2)], axis=1) @ ends
    hitched = np.isfinite(evaluation.planned[..., 0]).any(axis=1)
    at_clasps = np.stack([displacements[:, layout.starts], displacements[:, layout.ends]], axis=2)
    knots[hitched, :, 1:3] = at_clasps[hitched]
    shares = [np.interp(range(POINTS), (0, *CLASPS, POINTS - 1), one) for one in np.eye(4)]
    nodes = scene.cables + np.einsum("jp,tkjx->tkpx", shares, knots)
    return {
        "t": t,
        "nodes": nodes.reshape(len(t), -1, 3).astype(np.float32),
        "cables": POINTS * np.arange(layout.robots + 1),
        "poses": scene.objects.astype(np.float32),
    }


def latex_table(evaluation: Evaluation) -> str:
    """Return the short table as a LaTeX table [mm], with dashes for missing values.

    Of rows with the same samples, such as those of the only phase and of the whole flight, the
    first is written.
    """
    heads = ("mean", "std.", "max.", "std. error")
    lines = [
        r"\begin{table}",
        rf"\caption{{Distances from the plan [mm]; {evaluation.sag}.}}",
        r"\begin{tabular}{llrrrrr}",
        " & ".join(("of", "phase", *heads, "found")) + r" \\ \hline",
    ]
    written = set[tuple[str, ...]]()
    for row in evaluation.short_table:
        lengths = [1e3 * x for x in (row.mean, row.std, row.max, row.standard_error)]
        cells = [f"{x:.1f}" if np.isfinite(x) else "--" for x in lengths] + [f"{row.found:.2f}"]
        if (row.name, *cells) not in written:
            written.add((row.name, *cells))
            name = re.sub(r"^(.*\.)?([a-z])(\d+)$", r"\1$\2_{\3}$", row.name)
            lines.append(" & ".join((name, row.phase.replace("_", r"\_"), *cells)) + r" \\")
    return "\n".join([*lines, r"\end{tabular}", r"\end{table}", ""])


@style.own_style()
def drawn_evaluation(evaluation: Evaluation, width: float | None = None) -> Figure:
    """Return the picture: errors over time with their means, and the hitch from above.

    With a ``width`` [inch] it is a figure for a paper, without a headline.
    """
    from hitchopt.view.pictures import draw_phases  # heavy

    if width is None:
        figure = style.new_figure(SIZE)
        grid = figure.add_gridspec(2, 2, width_ratios=WIDTHS, height_ratios=(1.6, 1.0))
        over_time = (grid[0, 0], grid[1, 0])
        above = grid[:, 1]
    else:
        figure = style.page_figure(width, sum(PAGE_SHARES) * width + PAGE_LEGEND)
        grid = figure.add_gridspec(3, 1, height_ratios=PAGE_SHARES)
        over_time = (grid[0], grid[1])
        above = grid[2]
    top, bottom = (figure.add_subplot(place) for place in over_time)
    team = evaluation.task.team
    t = evaluation.t
    points = evaluation.task.team.layout.clasps
    colours = style.cable_colours(team.robots)
    summaries = {}
    for row in evaluation.short_table:
        if row.phase == "all" and np.isfinite(row.mean):
            summaries[row.name] = f"{1e3 * row.mean:.0f} ± {1e3 * row.std:.0f} mm"
    for point in points.tolist():
        colour = colours[point % team.robots]
        name = team.point_names[point]
        off, error = (
            1e3 * each[:, point] for each in (evaluation.errors, evaluation.standard_errors)
        )
        top.fill_between(t, off - error, off + error, color=colour, alpha=0.25, lw=0)
        top.plot(
            t, off, color=colour, lw=1.2, label=f"{name}: {summaries.get(name, 'not measured')}"
        )
    for i, name in zip(team.listed.tolist(), team.listed_names, strict=True):
        look: Any = {"ls": "-" if i % 2 == 0 else "--", "lw": 0.9, "color": colours[i // 2]}
        bottom.plot(t, 1e3 * evaluation.drone_errors[:, i], label=name, **look)
    kind = "crossings" if evaluation.clasps is None else "clasps"
    kind += ", ± standard error" if np.isfinite(evaluation.standard_errors).any() else ""
    for axes, words in (
        (top, f"vertex errors [mm]\n({kind})"),
        (bottom, "drones from their\nsetpoints [mm]"),
    ):
        axes.set(ylabel=words, xlim=(t[0], t[-1]))
        style.from_zero(axes, 0.3)
        if len(points) <= MAX_NAMED and width is None:
            axes.legend(fontsize="small", ncols=4, frameon=False)
    top.tick_params(labelbottom=False)
    bottom.set_xlabel("t [s]")
    start = float(t[0])
    end = float(t[-1])
    phases = [
        each.retimed(max(each.start, start), min(each.end, end))
        for each in evaluation.planned_flight.teams[0].motion.overlapping(start, end)
    ]
    draw_phases([top, bottom], phases, end - start)
    last = figure.add_subplot(above)
    _draw_from_above(last, evaluation, colours)
    if width is None:
        if last.get_legend_handles_labels()[0]:  # None without vertices and markers
            last.legend(fontsize="small", frameon=False)
        words = f"vertex errors: {summaries.get('vertices', 'not measured')}"
        style.headline(figure, evaluation.flight.source, words)
    else:
        named = [top, bottom, last] if len(points) <= MAX_NAMED else [last]
        handles = [handle for each in named for handle in each.get_legend_handles_labels()[0]]
        style.legend_on_page(figure, handles)
    return figure


def _draw_from_above(axes: Axes, evaluation: Evaluation, colours: Sequence[str]) -> None:
    """Draw paths, and at the last time of a complete polygon both polygons and the markers."""
    team = evaluation.task.team
    measured = evaluation.measured
    points = team.layout.clasps
    cloud = evaluation.cloud
    for i in range(team.drones):
        axes.plot(*evaluation.drones[:, i, :2].T, color=colours[i // 2], lw=0.6, alpha=0.5)
    for point in points.tolist():
        axes.plot(*measured[:, point, :2].T, color=colours[point % team.robots], lw=0.8)
    complete = np.flatnonzero(np.isfinite(measured[:, points, 0]).all(axis=1))
    if len(complete):
        i = complete[-1]
        order = np.append(points, points[: team.layout.closed])
        plan, polygon = (x[i, order, :2].T for x in (evaluation.planned, measured))
        axes.plot(*plan, "--", color=style.LIMIT_COLOUR, label="planned")
        axes.plot(*polygon, color=style.INK, lw=1.4, label="measured")
        near = np.abs(cloud.t - evaluation.t[i]) < SNAPSHOT_TIME
        if near.any():
            look: Any = {"s": 6, "color": "0.45", "zorder": 3, "label": "markers"}
            axes.scatter(*cloud.positions[near, :2].T, **look)
        axes.set_title(f"from above, t = {evaluation.t[i]:.2f} s", fontsize="medium")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x [m]", ylabel="y [m]")
