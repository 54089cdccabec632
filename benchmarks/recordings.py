"""Recordings with ground truth: markers on simulated ropes, and their evaluation.

Usage: python -m benchmarks recordings [--flights NAME ...] [--seed S] [--example]

Each plan is flown once, perturbed. Markers are three points in the middle of every edge that stay
with the rope; they are recorded with noise, losses, offsets from the rope's axis, or in another
frame. The truth is where the ropes' curves cross, seen from above. ``--example`` writes the
recording that is shipped, ``problems/friction.csv``, in place of the tables.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

import hitchopt as ho
from benchmarks.measuring import PROBLEMS, Array, Table, parser, timed
from hitchopt.lab.flights.evaluation import Evaluation
from hitchopt.lab.flights.recordings import RecordedFlight, Track, plan_at
from hitchopt.lab.simulation.task import TeamTask

RATE, EXAMPLE_RATE = 120.0, 25.0  # Of recordings, and of the one that is shipped [Hz]
EXAMPLE_DENSITY = 0.01  # Density of the ropes of that recording [kg/m]
SPACING = 0.15  # Distance between the markers of an edge [m]

LIMITATIONS = (
    "simulated flights (fast preset, perturbed, ropes of 12 mm), shapes of ropes at 25 Hz with "
    "splines between; markers do not pull on the ropes; one flight for each table"
)


@dataclass(frozen=True)
class Camera:
    """Errors of recorded markers and bodies."""

    noise: float = 3e-4  # standard deviation of each coordinate [m]
    lost: float = 0.05  # share of lost samples
    gap: float = 3.0  # mean length of gaps [frames]
    offset: float = 0.0  # distance of markers from the rope's axis [m], in a constant direction
    ghosts: float = 0.2  # mean number of false points per frame
    yaw: float = 0.0  # of the recording frame [rad]
    up: str = "z"  # vertical axis of the recording frame, ``z`` or ``y``
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)  # offset of the recording frame [m]
    start: float = 2.0  # recording time at the start of the plan [s]
    rate: float = 1.0  # of the recording clock

    def recorded(
        self, t: Array, drones: Array, markers: Array, seed: int, names: Sequence[str] = ()
    ) -> RecordedFlight:
        """Return a recording of drones (times, 2n, 3) and markers (times, k, 3) at plan times."""
        random = np.random.default_rng(seed)
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        if self.up == "y":
            R = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]) @ R
        offset = random.normal(size=markers.shape[1:])
        offset *= self.offset / np.linalg.norm(offset, axis=-1, keepdims=True)
        ghosts = random.uniform(np.min(drones, (0, 1)), np.max(drones, (0, 1)), (len(t), 2, 3))
        cloud = np.concatenate([markers + offset, ghosts], axis=1)
        visible = np.concatenate(
            [
                self._visibility(random, markers.shape[:2]),
                random.random((len(t), 2)) < 0.5 * self.ghosts,
            ],
            axis=1,
        )
        visible_drones = self._visibility(random, drones.shape[:2])
        cloud, drones = (
            (x + random.normal(0.0, self.noise, x.shape)) @ R.T + self.shift
            for x in (cloud, drones)
        )
        order = np.argsort(random.random(visible.shape), axis=1)  # random order of points
        cloud, visible = (
            np.take_along_axis(cloud, order[..., None], 1),
            np.take_along_axis(visible, order, 1),
        )
        t_recorded = self.start + self.rate * t
        names = names or [f"cf{i}" for i in random.permutation(90)[: drones.shape[1]]]
        tracks = {
            name: Track(t_recorded[is_visible], x[is_visible])
            for name, x, is_visible in zip(
                names, np.moveaxis(drones, 1, 0), visible_drones.T, strict=True
            )
        }
        return RecordedFlight(
            "synthetic", tracks, Track(t_recorded[np.nonzero(visible)[0]], cloud[visible])
        )

    def _visibility(self, random: np.random.Generator, shape: tuple[int, int]) -> Any:
        """Return the visibility (times, k), with gaps that begin and end at random."""
        visible = np.ones(shape, np.bool_)
        begins = self.lost / max(1.0 - self.lost, 1e-9) / self.gap
        lost = random.random(shape[1]) < self.lost
        for row in visible:
            draw = random.random(shape[1])
            lost = np.where(lost, draw > 1.0 / self.gap, draw < begins)
            row[:] = ~lost
        return visible


def exact_markers(task: TeamTask, t: Array, count: int = 3) -> Array:
    """Return markers (times, n count, 3) [m] on the parabolas of a plan's edges."""
    vertices, layout = plan_at(task, t, task.states.vertices), task.team.layout
    starts, edges = vertices[:, layout.starts], layout.edges(vertices)
    span = np.linalg.norm(edges[..., :2], axis=-1)
    curvature = task.team.cable_density * 9.81 / plan_at(task, t, task.states.tensions)
    found = []
    for place in SPACING * (np.arange(count) - 0.5 * (count - 1)):
        s = 0.5 * span + place
        point = starts + (s / span)[..., None] * edges
        point[..., 2] -= 0.5 * curvature * s * (span - s)
        found.append(point)
    return np.concatenate(found, axis=1)


def rope_markers(task: TeamTask, film: Any, t: Array, count: int = 3) -> tuple[Array, Array]:
    """Return markers (times, n count, 3) on simulated ropes, and their crossings (times, n, 3)."""
    layout, lengths = task.team.layout, task.team.cable_length
    nodes = CubicSpline(film.t, film.nodes.astype(np.float64))(t)
    formed = int(np.argmax(task.states.formed))
    legs = np.linalg.norm(
        task.states.positions[:, ::2] - task.states.vertices[:, layout.starts], axis=-1
    )
    edges = np.linalg.norm(layout.edges(task.states.vertices), axis=-1)
    markers, middles = [], []
    for k, (a, b) in enumerate(zip(film.cables[:-1], film.cables[1:], strict=True)):
        rope, step = nodes[:, a:b], lengths[k] / (b - a - 1)
        middles.append((rope, int((legs[formed, k] + 0.5 * edges[formed, k]) / step)))
        for place in SPACING * (np.arange(count) - 0.5 * (count - 1)):
            at = (legs[formed, k] + 0.5 * edges[formed, k] + place) / step
            i, share = int(at), at - int(at)
            markers.append((1.0 - share) * rope[:, i] + share * rope[:, i + 1])
    crossings = np.full((len(t), layout.points, 3), np.nan)
    for point, j, k in zip(layout.clasps, layout.behind, layout.ahead, strict=True):
        (first, i), (second, m) = middles[j], middles[k]
        crossings[:, point] = _first_crossing(first[:, i:], second[:, m::-1])
    return np.stack(markers, axis=1), crossings


def _first_crossing(a: Array, b: Array) -> Array:
    """Return where curves (times, nodes, 3) first cross seen from above, heights averaged."""
    p, r = a[:, :-1, None], np.diff(a, axis=1)[:, :, None]
    q, s = b[:, None, :-1], np.diff(b, axis=1)[:, None]

    def cross(u: Array, v: Array) -> Array:
        return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])

    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = cross(q - p, s) / cross(r, s), cross(q - p, r) / cross(r, s)
    inside = (x >= 0.0) & (x < 1.0) & (y >= 0.0) & (y < 1.0)
    order = np.add.outer(np.arange(inside.shape[1]), np.arange(inside.shape[2]))
    first = np.argmin(np.where(inside, order, 10**6).reshape(len(a), -1), axis=1)
    i, j = np.unravel_index(first, inside.shape[1:])
    k = np.arange(len(a))
    on_a = a[k, i] + x[k, i, j, None] * (a[k, i + 1] - a[k, i])
    on_b = b[k, j] + y[k, i, j, None] * (b[k, j + 1] - b[k, j])
    crossing = np.where(inside[k, i, j, None], on_a, np.nan)
    crossing[:, 2] = 0.5 * (on_a[:, 2] + on_b[:, 2])
    return crossing


def plan_of(name: str) -> ho.Plan:
    """Return the plan of a column of the table."""
    polygons: dict[str, tuple[Any, Any]] = {
        "triangle": (
            [[0, 0.6], [0.55, -0.35], [-0.5, -0.3]],
            [[0, 0.7], [0.45, -0.3], [-0.5, -0.4]],
        ),
        "sharp": ([[0, -1], [-0.4, 0.5], [0.4, 0.5]], [[0, -0.7], [-0.4, 0.5], [0.4, 0.5]]),
        "pentagon": (ho.regular_polygon(5, 0.9).vertices, ho.regular_polygon(5, 0.8).vertices),
    }
    first, second = polygons[name]
    team = ho.Team(
        len(first), cable_length=2.4, cable_density=0.006, cable_friction=0.1, tension=0.5
    )
    start = ho.Hitch.spread(team, first, altitude=1.2)
    rest = ho.Hold(2.0)
    return ho.solve(start, [rest, ho.Morph(second), rest, ho.Transport([0.3, 0.2, 1.4]), rest])


# Mean errors in the paper, which are the same for its second and third experiment
PAPER = {
    "paper_experiment_2": "0.082, 0.168, 0.762",
    "paper_experiment_3": "0.082, 0.168, 0.762",
    "paper_experiment_4": "0.036, 0.026, 0.043",
}
ROPES: Any = {"cable_density": 0.006, "cable_friction": 0.1}

ROWS = {
    "noise 0.3 mm": Camera(),
    "noise 2 mm, 20 % lost": Camera(noise=2e-3, lost=0.2),
    "40 % lost, gaps of 20 frames": Camera(lost=0.4, gap=20.0),
    "markers 3 mm aside": Camera(offset=3e-3),
    "frame fitted (yaw 37°, y up)": Camera(yaw=np.radians(37.0), up="y", shift=(0.4, 0.1, 0.2)),
    "2 mm, 40 %, 2 mm aside, clock 1 % slow": Camera(
        noise=2e-3, lost=0.4, offset=2e-3, rate=84.0 / 85.0
    ),
}


def fly(plan: ho.Plan, rate: float, seed: int, **settings: Any) -> tuple[Array, ...]:
    """Return times, drones, markers and true crossings of a perturbed flight of a plan."""
    flown = ho.simulate(plan, perturbed=True, seed=seed, pull_test=False, **settings)
    task = TeamTask.of(plan.motion)
    record = flown.flight.record
    t = np.arange(0.0, min(task.duration, record.t[-1]), 1.0 / rate)
    drones = CubicSpline(record.t, record.drones)(t)
    return t, drones, *rope_markers(task, flown.flight.film, t)


def write_example(seed: int) -> None:
    """Write the example recording: rows t, name, x, y, z, markers without names."""
    plan = ho.solve(PROBLEMS / "friction.yaml")
    t, drones, markers, _ = fly(plan, EXAMPLE_RATE, seed, density=EXAMPLE_DENSITY)
    flight = Camera(noise=5e-4, lost=0.1).recorded(t, drones, markers, seed)
    rows = [
        (t_, name, *place)
        for name, track in flight.tracks.items()
        for t_, place in zip(track.t.tolist(), track.positions.tolist(), strict=True)
    ]
    cloud = flight.markers
    points = zip(cloud.t.tolist(), cloud.positions.tolist(), strict=True)
    rows += [(t_, "marker", *place) for t_, place in points]
    lines = [f"{t_:.2f},{name},{x:.4f},{y:.4f},{z:.4f}" for t_, name, x, y, z in sorted(rows)]
    text = "\n".join(["t,name,x,y,z", *lines, ""])
    (PROBLEMS / "friction.csv").write_text(text, encoding="utf-8", newline="\n")


@dataclass(frozen=True)
class Comparison:
    """Evaluation of a recording, true crossings at its times, and processor time [s]."""

    evaluation: Evaluation
    true: Array
    elapsed: float

    @classmethod
    def of(cls, task: TeamTask, flown: Any, camera: Camera, seed: int) -> Comparison:
        """Record a flight with a camera and evaluate the recording."""
        t, drones, markers, crossings = flown
        recording = camera.recorded(t, drones, markers, seed)
        evaluation, elapsed = timed(lambda: ho.evaluate(recording, task))
        columns = [np.interp(evaluation.t, t, x) for x in crossings.reshape(len(t), -1).T]
        true = np.stack(columns, axis=1).reshape(evaluation.vertices.shape)
        true[np.isnan(evaluation.planned)] = np.nan
        return cls(evaluation, true, elapsed)

    def row(self) -> tuple[str, str, float]:
        """Return distances to the truth, detection rate with ratio of errors, and time [s]."""
        off = np.linalg.norm(self.evaluation.vertices - self.true, axis=-1)
        is_found, exists = np.isfinite(off), np.isfinite(self.true[..., 0])
        off, stated = off[is_found], self.evaluation.standard_errors[is_found]
        ratio = np.sqrt(np.mean(off**2) / np.mean(stated**2))
        distances = f"{1e3 * np.median(off):.1f}; {1e3 * np.percentile(off, 95):.1f}"
        return distances, f"{is_found.sum() / exists.sum():.2f}; {ratio:.1f}", self.elapsed


def experiment(name: str) -> ho.Plan:
    """Return the plan of an experiment of the paper, of cables with weight and friction."""
    problem = ho.load_problem(PROBLEMS / f"{name}.yaml")
    return ho.solve(replace(problem, team=replace(problem.team, **ROPES)))


def means(errors: Array) -> str:
    """Return the mean of every vertex [m]."""
    return ", ".join(f"{mean:.3f}" for mean in np.nanmean(errors, axis=0))


def main() -> None:
    """Print and write the tables."""
    cli = parser(__doc__, seed=7)
    names = ("triangle", "sharp", "pentagon")
    cli.add_argument("--flights", nargs="*", choices=names, default=list(names))
    cli.add_argument("--example", action="store_true")
    options = cli.parse_args()
    if options.example:
        write_example(options.seed)
        return
    path = options.output / "recordings.md"
    table = Table(path, "Recordings with ground truth", LIMITATIONS, ("mujoco",))
    columns = ("recorded with", "median; 95 % [mm]", "detected; actual / stated errors", "CPU [s]")
    for name in options.flights:
        plan = plan_of(name)
        flown = fly(plan, RATE, options.seed)
        table.section(f"{name}, {plan.duration:.1f} s", *columns)
        task = TeamTask.of(plan.motion)
        for words, camera in ROWS.items():
            table.row(words, *Comparison.of(task, flown, camera, options.seed).row())
    columns = ("experiment", "evaluated", "true crossings", "the paper's flight")
    table.section("The paper's experiments: mean errors of the vertices [m]", *columns)
    for name, paper in PAPER.items():
        plan = experiment(name)
        task, flown = TeamTask.of(plan.motion), fly(plan, RATE, options.seed)
        comparison = Comparison.of(task, flown, Camera(noise=5e-4, lost=0.1), options.seed)
        true = np.linalg.norm(comparison.true - comparison.evaluation.planned, axis=-1)
        table.row(
            name.removeprefix("paper_"), means(comparison.evaluation.errors), means(true), paper
        )
