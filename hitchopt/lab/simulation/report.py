"""Simulate a plan in MuJoCo: figures of the flight, tables over time, a recording and a picture."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.ndimage import uniform_filter1d

from hitchopt.errors import UNKNOWN_KEY, InputError, OneLine, Progress
from hitchopt.geometry.vectors import length
from hitchopt.lab.simulation.departures import DEPARTURES
from hitchopt.lab.simulation.exported import read_flown
from hitchopt.lab.simulation.flight import fly
from hitchopt.lab.simulation.judgement import (
    CampaignRun,
    LossOutcome,
    Outcome,
    Spread,
    VertexErrors,
    closest,
    judge,
    loss_outcome,
    separation_of,
    tension_ratios,
    tracking_errors,
    vertex_errors,
    warnings,
)
from hitchopt.lab.simulation.record import SimulatedFlight
from hitchopt.lab.simulation.rests import Rest, rests
from hitchopt.lab.simulation.settings import CALM, CLASPS, PRESETS, Settings, settings_of
from hitchopt.lab.simulation.task import Task
from hitchopt.motion.flight import Flight
from hitchopt.plan import Plan
from hitchopt.retired import refuse_retired
from hitchopt.storage.archive import RECORDING
from hitchopt.storage.files import Writer, replace_files, write_strict_json
from hitchopt.values import Array, check_choice, check_instance, closest_word, flag
from hitchopt.view import style
from hitchopt.view.painter import MAX_PANELS, Shot, draw_storyboard, shots_in_motion
from hitchopt.view.pictures import PAGE_LEGEND, PAGE_PLAN, PAGE_SHARE, draw_phases
from hitchopt.view.scene import Scene, recorded_scene

FORMAT = "hitchopt-simulation/1"

SUMMARY = "simulation.json"  # Figures and settings of a flight
PICTURES = ("simulation.png", "simulation.svg", "simulation.pdf")  # Pictures of a flight
VERTICES = "vertices.csv"  # Table of vertices
CABLES = "cables.csv"  # Table of cables
DRONES = "drones.csv"  # Table of drones
OBJECTS = "objects.csv"  # Table of objects
CAMPAIGN = "campaign.json"  # Figures of several flights
CAMPAIGN_PICTURE = "campaign.png"  # Picture of several flights
RUNS = "runs.csv"  # Table of several flights

# Names that belong to hitchopt in the directory of results; other files are never touched
OWNED = (
    SUMMARY,
    VERTICES,
    CABLES,
    DRONES,
    OBJECTS,
    RECORDING,
    *PICTURES,
    CAMPAIGN,
    CAMPAIGN_PICTURE,
    RUNS,
)

SIZE = (13.0, 7.2)  # Width and height of the picture [inch]
WIDTHS = (1.25, 1.0)  # Width ratios of storyboard and plots, as in a plan's summary
PAGE_PLOT = 1.3  # Height of a plot on a page [inch]
MEAN_TIME = 0.2  # Averaging time of thick tension curves [s]
MAX_LABELS = 6  # Largest number of vertices in the legend
ROPE_RADIUS = 0.005  # Radius of drawn ropes, over the flight's extent
MAX_ROPE_RADIUS = 0.02  # Largest radius of drawn ropes [m]
SHOT_TOLERANCE = 0.1  # Largest time between a shot and its frame [s]

# Kinds of failures that do not depend on the state of the hitch at the end
OTHER_FAILURES = (*DEPARTURES, "touch", "dropped", "misplaced", "caught")


@dataclass(frozen=True, eq=False)
class Simulation(OneLine):
    """A flight, its outcome, and the errors of its vertices."""

    flight: SimulatedFlight
    outcome: Outcome
    errors: VertexErrors

    @classmethod
    def of(cls, task: Task, settings: Settings, progress: Progress | None = None) -> Simulation:
        """Return a simulated flight of a task; parameters and errors are those of ``fly``."""
        return cls.judged(fly(task, settings, progress))

    @classmethod
    def judged(cls, flight: SimulatedFlight) -> Simulation:
        """Return a flight with its outcome and errors."""
        return cls(flight, judge(flight), vertex_errors(flight))

    @property
    def settings(self) -> Settings:
        """Settings of the flight."""
        return self.flight.settings

    @property
    def loss(self) -> LossOutcome | None:
        """Outcome for the other drones after a loss; None without a loss."""
        return loss_outcome(self.flight)

    @cached_property
    def rests(self) -> tuple[Rest, ...]:
        """Verdicts at all rests with a taut hitch."""
        return rests(self.flight, self.outcome)

    @property
    def spreads(self) -> dict[str, Spread]:
        """Spreads of errors of vertices, sag included, and of drones from their setpoints [m].

        ``tension_ratio`` is that of tensions over the planned ones while the hitch is taut.
        """
        errors = self.errors
        return {
            "vertex_error": Spread.of(errors.errors),
            "resting": Spread.of(errors.errors[~errors.moving]),
            "moving": Spread.of(errors.errors[errors.moving]),
            "without_sag": Spread.of(errors.without_sag),
            "tracking": Spread.of(tracking_errors(self.flight)),
            "tension_ratio": Spread.of(tension_ratios(self.flight, self.errors.rows)),
        }

    @property
    def figures(self) -> dict[str, float]:
        """Figures by name, such as ``tracking_mean``; nan for missing ones.

        These are the spreads, the least ``separation`` of drones, ``peak_tension`` and
        ``peak_thrust`` [N], ``peak_tilt`` [°], and the largest ``placed`` [m], ``tilted`` [°] and
        ``slipped`` [m] of objects.
        """
        record = self.flight.record
        spreads = self.spreads.items()
        values = {f"{name}_{key}": v for name, spread in spreads for key, v in vars(spread).items()}
        values["separation"] = closest(self.flight, separation_of(self.flight).scale).distance
        values["peak_tension"] = float(np.max(record.peak_tensions))
        values["peak_thrust"] = float(np.max(record.thrusts))
        values["peak_tilt"] = float(np.degrees(np.max(record.tilts)))
        for name in ("placed", "tilted", "slipped"):
            column = [np.nan, *(getattr(each, name) for each in self.outcome.objects)]
            values[name] = float(np.fmax.reduce(column))
        return values

    @property
    def run(self) -> CampaignRun:
        """Row of a campaign for this flight."""
        return CampaignRun(
            self.settings.seed,
            self.outcome.verdict,
            self.outcome.failures,
            self.figures,
            {
                str(rest): {name: vertex.mean for name, vertex in rest.vertices.items()}
                for rest in self.rests
            },
        )

    def save(
        self,
        directory: Path | str,
        title: str = "",
        flight: Flight | None = None,
        format: str = "png",
        width: float | None = None,
    ) -> Path:
        """Write the summary, tables, recording and picture, all or none; return the directory.

        The picture shows the plan that was flown, or another ``flight``, under a title, as
        ``simulation.png``, ``svg`` or ``pdf``; with a ``width`` [inch] it is a figure for a paper.

        Raises
        ------
        FileError: writing fails.
        InputError: setpoints without a plan were flown, and no plan is given.
        """
        shown = self.flight.task.flight if flight is None else flight
        if shown is None:
            raise InputError("flight", None, "the plan of the setpoints", "pass its flight")
        picture = drawn_flight(self, shown, title, width)
        simulated, errors = self.flight, self.errors
        task, record = simulated.task, simulated.record
        team, cargo = task.team, task.cargo
        rows, t, off = errors.rows, record.t, length(record.drones - record.commanded)
        drones, cables = team.listed, team.edges
        vertices: Iterable[object] = team.layout.clasps
        if len(task.teams) > 1:
            vertices = [team.point_names[point] for point in team.layout.clasps]
        # Kind and names of the rows, their times (times,), and columns (times, names[, columns])
        tables: dict[str, tuple[str, Iterable[object], Array, dict[str, Any]]] = {
            VERTICES: ("vertex", vertices, errors.t, {
                "x,y,z": record.vertices[rows],
                "planned_x,planned_y,planned_z": errors.planned,
                "height_error": errors.offsets[..., 2],
                "error": errors.errors,
                "error_without_sag": errors.without_sag,
                "bearing": record.bearing[rows],
            }),
            CABLES: ("cable", _cables(simulated), t, {
                "tension": record.tensions[:, cables], "peak": record.peak_tensions[:, cables],
            }),
            DRONES: ("drone", team.listed_names, t, {
                "x,y,z": record.drones[:, drones], "error": off[:, drones],
                "thrust": record.thrusts[:, drones], "tilt": record.tilts[:, drones],
            }),
            OBJECTS: ("object", cargo.names, t, {
                "x,y,z,qw,qx,qy,qz": record.poses, "touched": record.touched,
            }),
        }  # fmt: skip
        if not cargo.objects:
            del tables[OBJECTS]
        writers: dict[str, Writer] = {name: partial(write_table, *v) for name, v in tables.items()}
        writers[RECORDING] = lambda path: np.savez_compressed(path, **vars(simulated.film))
        writers[f"simulation.{format}"] = lambda path: style.save_figure(picture, path)
        writers[SUMMARY] = lambda path: write_strict_json(path, summary(self))
        return replace_files(directory, writers, OWNED, seal=SUMMARY)


def simulate(
    plan: Plan | Path | str,
    *,
    preset: Literal["fast", "accurate"] = "fast",
    perturbed: bool = False,
    perturbations: dict[str, float | bool] | None = None,
    progress: Progress | None = None,
    **settings: Any,
) -> Simulation:
    """Fly a plan with simulated cables; return the flight with its results.

    By default these are ropes in MuJoCo. With ``cables="clasps"`` they slide through clasps while
    the hitch is tied, which measures vertices and is fast.

    The flight uses the plan's cables, drones and controllers, with the filter and files exported
    for them, unless settings replace them.

    Parameters
    ----------
    plan: a plan with cables, the directory of a saved one, or the folder of an export. The hitches
        of several teams fly in one world; single drones and drones of other plans follow their
        setpoints exactly.
    preset: of ropes. ``fast``: links of 30 mm, which show whether the hitch holds; ``accurate``: of
        10 mm, five times slower, with correct friction, to measure vertices.
    perturbed: whether to add the usual disturbances of an indoor flight.
    perturbations: fields of ``Perturbations`` with other values, such as ``wind`` [N].
    progress: status callback.
    settings: further fields of ``Settings``: ``seed``, ``cables`` (ropes or clasps), ``friction``,
        ``density``, ``stiffness``, ``pull_test``; ``controller`` by name or ``ideal``, ``gains``,
        ``upload`` and an ``estimator``: ``ideal``, ``crazyflie``, ``firmware``, ``one_marker``.

    Raises
    ------
    InputError: an argument is invalid.
    CertificateError: the plan's certificate does not hold.
    UnsupportedError: mujoco is not installed, or the plan has only single drones; with clasps,
        several teams or objects that can move.
    """
    check_choice("preset", preset, tuple(PRESETS))
    changes = {} if perturbations is None else perturbations
    _check_names("perturbations", changes, vars(CALM))
    for name in settings.keys() & vars(CALM).keys():
        remedy = f"write perturbations={{{name!r}: {settings[name]!r}}}"
        raise InputError(name, settings[name], UNKNOWN_KEY, remedy)
    _check_names("settings", settings, vars(Settings()))
    is_perturbed = flag("perturbed", perturbed)
    options = settings_of(preset, perturbed=is_perturbed, **settings, **changes)
    if isinstance(plan, str | Path):
        return Simulation.of(read_flown(Path(plan)), options, progress)
    check_instance("plan", plan, Plan)
    plan.certificate.raise_if_violated()
    return Simulation.of(Task.of(plan.flight), options, progress)


def _check_names(key: str, options: dict[str, Any], names: dict[str, Any]) -> None:
    """Raise InputError unless the options are a dict of known names."""
    if not isinstance(options, dict):
        raise InputError(key, options, "a dict", f"use the keys {', '.join(names)}")
    for name in options.keys() - names.keys():
        as_option = str(name).replace("_", "-")
        refuse_retired(f"simulate --{as_option}" if key == "settings" else f"--perturb {name}")
        remedy = closest_word(str(name), [*names])
        raise InputError(f"{key}.{name}", options[name], UNKNOWN_KEY, remedy)


def _cables(flight: SimulatedFlight) -> Sequence[object]:
    """Return the cables' names in files, in order: indices, or names for several teams."""
    return flight.cable_names if len(flight.task.teams) > 1 else range(flight.task.team.robots)


def write_table(
    kind: str, names: Iterable[object], t: Array, columns: dict[str, Any], path: Path
) -> None:
    """Write a table with a row per time and name."""
    values = np.concatenate([np.atleast_3d(column) for column in columns.values()], axis=-1)
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["t", kind, *",".join(columns).split(",")])
        for time, rows in zip(t.tolist(), values.tolist(), strict=True):
            for name, row in zip(names, rows, strict=True):
                table.writerow([number(time), str(name), *map(number, row)])


def number(value: float, digits: int = 9) -> str:
    """Return a number with some significant digits; an empty text for nan."""
    return "" if math.isnan(value) else f"{value:.{digits}g}"


def summary(simulation: Simulation) -> dict[str, Any]:
    """Return the figures of a flight, ready for JSON."""
    flight, outcome, errors = simulation.flight, simulation.outcome, simulation.errors
    record, team, figures = flight.record, flight.task.team, simulation.figures
    spreads = {name: asdict(spread) for name, spread in simulation.spreads.items()}
    clasps = [team.point_names[p] for p in team.layout.clasps]
    perturbed = {
        name: {"mass": body.mass, "friction": body.friction, "stood_at": body.at.tolist()}
        for name, body in flight.objects.items()
    }
    each = {name: asdict(Spread.of(errors.errors[:, c])) for c, name in enumerate(clasps)}
    means, peaks = np.mean(record.tensions, axis=0), np.max(record.peak_tensions, axis=0)
    ratios = [Spread.of(each).mean for each in tension_ratios(flight, errors.rows).T]
    columns = (np.array(each)[team.edges].tolist() for each in (means, peaks, ratios))
    tensions = zip(_cables(flight), *columns, strict=True)
    planned = [part.team.cable_density for part in flight.task.teams for _ in part.team.tension]
    return {
        "format": FORMAT,
        "settings": asdict(simulation.settings),
        "warnings": list(warnings(flight.task, simulation.settings)),
        "position_loops": {name: gains.tolist() for name, gains in vars(flight.gains).items()},
        "compensation": {"cables_longer": flight.extra_length, "legs_aside": flight.end_offset},
        "density": {
            "simulated": np.asarray(flight.density).tolist(),
            "planned": planned if len(flight.task.teams) > 1 else planned[0],
        },
        "nearest": closest(flight)._asdict(),
        "separation": closest(flight, separation_of(flight).scale)._asdict(),
        "verdict": outcome.verdict,
        "succeeded": outcome.succeeded,
        "hitched": outcome.hitched,
        "failures": [asdict(failure) for failure in outcome.failures],
        "clasps": [asdict(clasp) for clasp in outcome.clasps],
        "objects": [asdict(each) | perturbed[each.name] for each in outcome.objects],
        "vertex_error": {
            "all": spreads["vertex_error"],
            "resting": spreads["resting"],
            "moving": spreads["moving"],
            "all_without_sag": spreads["without_sag"],
            **each,
        },
        "rests": [rest.to_dict() for rest in simulation.rests],
        "tension": [
            dict(zip(("cable", "mean", "peak", "over_planned"), each, strict=True))
            for each in tensions
        ],
        "tension_ratio": spreads["tension_ratio"],
        "tracking_error": spreads["tracking"],
        "largest_thrust": figures["peak_thrust"],
        "largest_tilt": figures["peak_tilt"],
        "duration": flight.task.duration,
        **({} if simulation.loss is None else {"loss": asdict(simulation.loss)}),
    }


@style.own_style()
def drawn_flight(
    simulation: Simulation, plan: Flight, title: str = "", width: float | None = None
) -> Figure:
    """Return the picture of a flight of a plan: a storyboard, and errors and tensions over time.

    With a ``width`` [inch] it is a figure for a paper, without a headline.
    """
    if width is None:
        figure = style.new_figure(SIZE)
        parts = figure.add_gridspec(1, 2, width_ratios=WIDTHS)
    else:
        heights = min(PAGE_SHARE * width, PAGE_PLAN), 3.0 * PAGE_PLOT
        figure = style.page_figure(width, sum(heights) + PAGE_LEGEND)
        parts = figure.add_gridspec(2, 1, height_ratios=heights)
    scene = flight_scene(simulation, plan)
    if scene is not None:  # shots of the plan up to the end, and the end
        start, end = float(max(scene.t[0], 0.0)), float(scene.t[-1])
        first, last = start - SHOT_TOLERANCE, end + SHOT_TOLERANCE
        shots = [shot for shot in shots_in_motion(plan) if first <= shot.time <= last]
        if start > SHOT_TOLERANCE:  # only a part of the plan is simulated
            shots = [Shot("start", start), *shots]
        if np.isfinite(simulation.flight.pulled):
            words = "pull test" if simulation.flight.task.states.formed[-1] else "at rest"
            shots = [*shots[: MAX_PANELS - 1], Shot(words, end, essential=True)]
        radius = ROPE_RADIUS * float(np.linalg.norm(np.ptp(scene.drones, axis=(0, 1))))
        thick = replace(scene, radius=float(np.clip(radius, scene.radius, MAX_ROPE_RADIUS)))
        draw_storyboard(parts[0], thick, shots, (scene.t, scene.drones))
    rows = parts[1].subgridspec(3, 1)
    plots = [figure.add_subplot(rows[row]) for row in range(3)]
    _draw_over_time(plots, simulation, plan)
    if width is None:
        style.headline(figure, title, f"{style.facts(plan)}, simulated: {ending(simulation)}")
        return figure
    figure.align_ylabels(plots)
    if legend := plots[0].get_legend():
        style.legend_on_page(figure, list(filter(None, legend.legend_handles)))
        legend.remove()
    else:
        style.set_page_text(figure)
    return figure


def flight_scene(simulation: Simulation, plan: Flight) -> Scene | None:
    """Return the scene of a flight of a plan; None if it ended too early."""
    film = simulation.flight.film
    if np.sum(film.t >= 0.0) < 2:
        return None
    return recorded_scene(plan, film.t, film.nodes, film.cables, film.poses)


def _draw_over_time(plots: Sequence[Axes], simulation: Simulation, plan: Flight) -> None:
    """Draw errors of vertices, tensions and errors of drones."""
    flight, errors = simulation.flight, simulation.errors
    record, task = flight.record, flight.task
    team, start, end = task.team, float(max(record.t[0], 0.0)), float(record.t[-1]) or 1.0
    looks = style.team_colours(plan)[: len(plan.teams)]
    colours = [colour for _, cables in looks for colour in cables]
    top, middle, bottom = plots
    for c, (point, k) in enumerate(zip(team.layout.clasps, team.layout.ahead, strict=True)):
        t, values = _interrupted(errors.t, 100.0 * errors.errors[:, c])
        top.plot(t, values, color=colours[k], lw=1.2, label=team.point_names[point])
    if errors.t.size and len(team.layout.clasps) <= MAX_LABELS:
        top.legend(fontsize="small", ncols=MAX_LABELS, frameon=False)
    samples = max(1, round(MEAN_TIME * len(record.t) / end))
    smooth = uniform_filter1d(record.tensions, samples, axis=0)
    for k, colour in enumerate(colours):
        middle.plot(record.t, record.tensions[:, k], color=colour, lw=0.4, alpha=0.25)
        middle.plot(record.t, smooth[:, k], color=colour, lw=1.2)
    each = [part.states for part in task.teams]
    planned = [np.where(states.formed[:, None], states.tensions, np.nan) for states in each]
    for tension in np.unique(np.concatenate(planned, axis=1).T, axis=0):
        line: dict[str, Any] = {"color": style.LIMIT_COLOUR, "lw": 1.2, "ls": style.DASHES}
        middle.plot(each[0].t - each[0].t[0], tension, **line)
    tracking = 100.0 * np.max(tracking_errors(flight), axis=-1)
    bottom.plot(record.t[: len(tracking)], tracking, color=style.INK, lw=1.2)
    first = "vertex error" if simulation.settings.measures_vertices else "vertex error\n± 1 to 2 cm"
    second = f"tension [N]\nplanned: dashed\nthick: {MEAN_TIME:g} s average"
    titles = f"{first},\nsag included [cm]", second, "largest drone\nerror [cm]"
    drawn = 100.0 * errors.errors, record.tensions, tracking
    for axes, words, values in zip(plots, titles, drawn, strict=True):
        axes.set_ylabel(words)
        axes.set_xlim(start, end)
        style.from_zero(axes, 0.3 if axes.get_legend() else 0.1, values)
        axes.tick_params(labelbottom=axes is bottom)
        if end > task.duration:
            axes.axvspan(task.duration, end, facecolor="none", edgecolor="0.8", hatch="////", lw=0)
    draw_phases(plots, plan.phases, end, start)
    bottom.set_xlabel("t [s]; hatched: rest and pull test")
    # A fixed number of ticks: with more of them after the layout, the last label would be clipped.
    bottom.locator_params("x", nbins=7, steps=[1, 2, 5, 10])


def _interrupted(t: Array, values: Array) -> tuple[Array, Array]:
    """Return samples with nan in between where some are missing, so that no line joins them."""
    if t.size < 2:
        return t, values
    steps = np.diff(t)
    gaps = np.flatnonzero(steps > 1.5 * np.median(steps)) + 1
    return np.insert(t, gaps, np.nan), np.insert(values, gaps, np.nan)


def ending(simulation: Simulation) -> str:
    """Return the end of a flight in words, such as a hitch that holds or is untied."""
    flight, loss = simulation.flight, simulation.loss
    if loss is not None:
        return "no two survivors touch" if loss.collision_free else "survivors TOUCH each other"
    if flight.linking is None:
        with_clasps = flight.settings.cables == CLASPS and flight.error is None
        return "only the tied hitch was flown" if with_clasps else "not simulated to its end"
    ends, parts = [part.states.formed[-1] for part in flight.task.teams], list[str]()
    failures = simulation.outcome.failures
    at_end = {each.kind for each in failures if each.time >= flight.task.duration}
    if any(ends):
        parts.append("every vertex holds" if simulation.outcome.hitched else "not hitched")
    if not all(ends):
        parts.append("not untied" if "tangled" in at_end else "untied, as planned")
    words = " and ".join(parts)
    others = [
        each.words
        for each in failures
        if each.kind in OTHER_FAILURES or each.time < flight.task.duration
    ]
    return f"{words}, but {others[0]}" if others else words
