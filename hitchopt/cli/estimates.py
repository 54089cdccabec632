"""The commands statics, calibrate and fit: what can be said of a hitch without flying it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hitchopt.cli.failures import unmet
from hitchopt.cli.options import command, plan_path
from hitchopt.cli.output import LateProgress, record, say, span_text, table
from hitchopt.errors import InfeasibleError, InputError

if TYPE_CHECKING:
    from hitchopt.holding.capacity import Capacity
    from hitchopt.statics.calibrate import Calibration, Estimate
    from hitchopt.statics.fit import Fit
    from hitchopt.statics.settle import Settled
    from hitchopt.statics.tolerance import Errors, Tolerance

USUAL_CABLE, USUAL_POSITION = "0.01", "0.02"
"""[m] Bounds of errors if --tolerance stands alone: cables cut to a centimetre, drones flown by
motion capture."""

MAX_TIMES = 1000
"""Most times that one call settles."""

MOST_ROWS = 24
"""Cables or vertices that a table shows; the others are in statics.json."""

CIRCLE = "circle:"


@command(
    "directory DIR",
    """
    --at T: Time [s]; repeatable.
    --samples N (25): Times without --at.
    --stiffness N/M (float): Of the position loops; inf is rigid.
    --integral/--no-integral (None): Position errors are driven to zero.
    --feed-forward/--no-feed-forward (None): The cable force is fed forward.
    --cable-length M[,M…] (text): Real lengths: one, or one per cable [m].
    --density KG/M (float): Real cable density.
    --load KG (float): Real mass at every clasp.
    --axial-stiffness N (float): EA of the cables; 10 kN.
    --friction MU (float): Real friction at the clasps, for the bands of rest.
    --tolerance: Ranges for errors: cables ±1 cm, drones ±2 cm, or as given.
    --cable-error M (text): Error of cable lengths: 0.01 bound, sd:0.01.
    --position-error M (text): Error of drones' positions, likewise.
    --force-error N (text): Error of the force feed-forward, likewise.
    """,
    at={"name": "times", "type": float, "multiple": True},
)
def statics(
    directory: Path,
    times: tuple[float, ...],
    samples: int,
    cable_length: str | None,
    density: float | None,
    cable_error: str | None,
    position_error: str | None,
    force_error: str | None,
    *,
    tolerance: bool,
    **given: Any,
) -> None:
    """Settle the hitch of the plan in DIR: where it rests, with what tensions, in which ranges.

    What is not given is the plan's: lengths, density, friction, and the drones' controllers. With
    friction a vertex rests anywhere in its band, as the clasps' history has it. Writes statics.json
    and statics.png to DIR. Ends with 3 if a cable is slack or a clasp does not hold.
    """
    from hitchopt.motion.plan_file import read_plan
    from hitchopt.statics.files import save_statics, statics_content
    from hitchopt.statics.settle import Conditions, settle_motion
    from hitchopt.statics.tolerance import taut_times, tolerance_of_motion

    path = plan_path(directory)
    sizes = {"cable": cable_error, "position": position_error, "force": force_error}
    errors = _errors(sizes, usual=tolerance)
    if not 0 < max(samples, len(times)) <= MAX_TIMES or samples < 1:
        raise InputError("--samples", samples, f"from 1 to {MAX_TIMES}", "25 are usual")
    chosen = {name: value for name, value in given.items() if value is not None}
    lengths = None if cable_length is None else _lengths(cable_length)
    conditions = Conditions(cable_length=lengths, cable_density=density, **chosen)
    motion = read_plan(path)
    t = list(times) if times else taut_times(motion, samples)
    with LateProgress("settling"):
        if errors is None:
            ranges, settled = None, settle_motion(motion, t, conditions)
        else:
            ranges = tolerance_of_motion(motion, t, errors, conditions)
            settled = ranges.settled
        save_statics(path.parent, settled, ranges)
    say(_statics_tables(settled, ranges))
    for note in conditions.notes(motion.team):
        say(f"note: {note}")
    record(directory=str(path.parent), statics=statics_content(settled, ranges))
    say(f"statics.json and statics.png are in {path.parent}")
    if settled.slack_cables or settled.loose_clasps:
        names = ", ".join((*settled.slack_cables, *settled.loose_clasps))
        say(f"slack, or without hold: {names}", err=True)
        unmet()


def _lengths(text: str) -> float | list[float]:
    """Return the lengths that a text says, one or several."""
    try:
        lengths = [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError("--cable-length", text, "numbers with commas", "2.4,2.41,2.39") from None
    return lengths[0] if len(lengths) == 1 else lengths


def _errors(texts: dict[str, str | None], *, usual: bool) -> Errors | None:
    """Return the errors that were given; None if there are none."""
    from hitchopt.statics.tolerance import Errors, ErrorSize

    given = {name: text for name, text in texts.items() if text is not None}
    if not given and usual:
        given = {"cable": USUAL_CABLE, "position": USUAL_POSITION}
    if not given:
        return None
    parsed = {name: ErrorSize.of(f"--{name}-error", text) for name, text in given.items()}
    return Errors(**parsed)


def _statics_tables(settled: Settled, ranges: Tolerance | None) -> str:
    """Return the tables of cables and vertices, each with its extremes over the times."""
    import numpy as np

    cables, vertices, t = [], [], settled.t
    for k in range(min(settled.team.robots, MOST_ROWS)):
        tensions = [settled.planned_tensions[:, k], settled.tensions[:, k]]
        slack = "yes" if settled.slack[:, k].any() else "no"
        if ranges is not None:
            tensions.append(ranges.tensions[:, k].ravel())
            slack = "may be" if slack == "no" and ranges.slack[:, k].any() else slack
        cables.append((f"c{k}", *map(span_text, tensions), slack))
    names = settled.team.point_names
    rubbing = bool(np.any(settled.rests[:, 0] != settled.rests[:, 1]))
    lower = 1e3 * (settled.planned_vertices[..., 2] - settled.vertices[..., 2])
    for k, name in enumerate(names[:MOST_ROWS]):
        row = [name, f"{1e3 * settled.displacements[:, k].max():.1f}"]
        row.append(span_text(lower[:, k], ".1f"))
        if rubbing:
            ends = settled.band[:, k]
            row.append(f"{1e3 * ends[:, 0].min():+.0f} to {1e3 * ends[:, 1].max():+.0f}")
        if ranges is not None:
            row.append(f"±{1e3 * ranges.radii[:, k].max():.1f}")
        vertices.append(row)
    tensions_head = ["planned [N]", "at rest [N]", "range [N]"]
    moved_head = ["from the plan [mm]", "lower by [mm]"]
    if rubbing:
        moved_head.append("band of rest, outward [mm]")
    if ranges is not None:
        moved_head.append("range around it [mm]")
    count = 2 if ranges is None else 3
    cables_title, title = _title("Cables", settled.team.robots), _title("Vertices", len(names))
    when = f"at t = {t[0]:g} s" if len(t) == 1 else f"at {len(t)} times, {t[0]:g} to {t[-1]:g} s"
    rest = (
        f"{when}; forces balance to {settled.force_residual.max():.1e} N, lengths to "
        f"{settled.length_residual.max():.1e} m"
    )
    if ranges is not None:
        rest += (
            f"\nranges include {ranges.tension_remainders.max():.3g} N and "
            f"{1e3 * ranges.vertex_remainders.max():.3g} mm beyond first order"
        )
    shown = table(cables_title, ["cable"], tensions_head[:count], cables, ["slack"])
    return "\n\n".join([shown, table(title, ["vertex"], moved_head, vertices), rest])


def _title(what: str, count: int) -> str:
    more = f" (the first {MOST_ROWS} of {count})" if count > MOST_ROWS else ""
    return f"{what}: smallest to largest value over the times{more}"


@command(
    "recording RECORDING",
    """
    --plan DIR (path): Plan flown; else where RECORDING lies.
    -o, --output FILE (path): Team with the estimates (YAML).
    --picture FILE (path): Recording and plan, .png or .pdf.
    --density KG/M (float): Cable density, as weighed.
    """,
)
def calibrate(
    recording: Path,
    plan: Path | None,
    output: Path | None,
    picture: Path | None,
    density: float | None,
) -> None:
    """Estimate cable lengths, stiffness and friction from a recorded flight.

    RECORDING is a CSV file with the columns t, name, x, y, z: seconds from the plan's start, q0,
    r0, … or p0, …, and metres; or the results of `hitchopt simulate`, DIR/simulation. Estimates
    come with standard errors, and what the recording does not determine is said so. Distances to
    the plan are in three dimensions.
    """
    from hitchopt.statics.calibrate import calibrate as calibrated
    from hitchopt.statics.files import save_calibration_picture, save_team

    place = None if plan is None else plan_path(plan).parent
    with LateProgress("estimating"):
        found = calibrated(recording, place, density=density)
    record(
        lengths=[vars(estimate) for estimate in found.lengths],
        stiffness=[vars(estimate) for estimate in found.stiffness],
        friction=vars(found.friction),
    )
    say(_calibration_tables(found))
    if output is not None:
        save_team(output, found)
        say(f"the team is in {output}")
    if picture is not None:
        save_calibration_picture(picture, found)
        say(f"the picture is {picture}")


def _calibration_tables(found: Calibration) -> str:
    """Return the tables of estimates and of distances to the plan."""
    from hitchopt.cli.simulating import spread_text

    team, remarks, rows = found.task.team, [], []

    def add(name: str, estimate: Estimate, unit: str, planned: float) -> None:
        value, error = "not determined", ""
        if estimate.known:
            digits = ".4f" if unit == "m" else ".3g"
            value, error = f"{estimate.value:{digits}} {unit}", f"{estimate.error:.1g}"
        else:
            remarks.append(f"{name}: {estimate.remark}")
        stated = f"{planned:.4g} {unit}" if math.isfinite(planned) else "rigid"
        rows.append((name, value, error, stated))

    for k, estimate in enumerate(found.lengths):
        add(f"length of cable {k}", estimate, "m", float(team.cable_length[k]))
    same = len(set(found.stiffness)) == 1
    for k, estimate in enumerate(found.stiffness[:1] if same else found.stiffness):
        name = "stiffness" if same else f"stiffness of q{k}, r{k}"
        add(name, estimate, "N/m", float(team.stiffness[2 * k]))
    add("friction", found.friction, "", team.cable_friction)
    estimates = table("Estimates", ["quantity"], ["value", "± error", "in the plan"], rows)
    compared = found.comparison
    distances = [
        (name, *map(spread_text, spreads))
        for names, columns in (
            (team.point_names, compared.vertices),
            (team.drone_names, compared.drones),
        )
        for name, spreads in zip(names, compared.spreads(columns), strict=True)
    ]
    title = "Distances to the plan [cm], mean ± standard deviation (largest)"
    heads = ["whole flight", "plan at rest", "plan moving"]
    return "\n\n".join([estimates, *remarks, table(title, ["of"], heads, distances)]) + "\n"


@command(
    "outline OUTLINE",
    """
    --robots N (int): Number of robots.
    -o, --output DIR (path): Directory for fit.json and fit.png; nothing is written without it.
    --clearance M (0.035): Of cables, while enclosing.
    --object-height M (0.3): Height of the object.
    --mass KG (float): To be held; ends with 3 if it is not.
    --by grip|rest (grip): How --mass is to be held.
    --friction FLOAT (0.5): Between cables and object.
    --clasp-friction FLOAT (0.15): Of cables on each other.
    --tension N (float): Of all cables; the largest level pull.
    --cable-length M (float): Of all cables; the shortest.
    --tilt-deg DEG (45.0): Largest tilt of drones.
    --quadrotor-mass KG (0.132): Of every drone.
    --max-thrust N (2.6): Of every drone.
    """,
    outline={"type": str},
    robots={"required": True},
    object_height={"name": "height"},
)
def fit(
    outline: str,
    robots: int,
    output: Path | None,
    mass: float | None,
    by: str,
    tilt_deg: float,
    quadrotor_mass: float,
    max_thrust: float,
    **given: Any,
) -> None:
    """Fit a hitch to OUTLINE: what encloses it, what grips it, what it rests on, and how much.

    OUTLINE is a drawing (SVG, DXF, GeoJSON, CSV), points as '[[x, y], …]', or circle:RADIUS, in
    metres unless a drawing states its unit.
    """
    from hitchopt.hitch import Quadrotor
    from hitchopt.hitch.requirements import Limits
    from hitchopt.statics.files import fit_as_json, save_fit
    from hitchopt.statics.fit import fit as fitted
    from hitchopt.values import positive

    if not 0.0 < tilt_deg < 90.0:
        raise InputError("--tilt-deg", tilt_deg, "above 0 and below 90", "45 is usual")
    if mass is not None:
        positive("--mass", mass)
    kind = Quadrotor(quadrotor_mass, max_thrust)
    limits = Limits(tilt=math.radians(tilt_deg))
    with LateProgress("fitting"):
        found = fitted(_outline(outline), robots, quadrotor=kind, limits=limits, **given)
        text = "\n\n".join([*(f"note: {x}" for x in found.notes), _polygons(found), _masses(found)])
    record(fit=fit_as_json(found))
    say(text)
    if output is not None:
        save_fit(output, found)
        record(directory=str(output))
        say(f"fit.json and fit.png are in {output}")
    if mass is not None:
        found.raise_if_too_heavy(mass, by)
        say(f"{1e3 * mass:g} g are held by {by}")


def _outline(text: str) -> object:
    """Return the outline that an argument names: a radius, points, or the path of a drawing."""
    from hitchopt.storage.files import parsed_json

    if text.startswith(CIRCLE):
        try:
            return float(text.removeprefix(CIRCLE))
        except ValueError:
            raise InputError("OUTLINE", text, "circle:RADIUS", "write circle:0.2") from None
    if text.lstrip().startswith("["):
        try:
            return parsed_json(text)
        except ValueError:
            raise InputError("OUTLINE", text, "[[x, y], …]", "write it as JSON") from None
    return Path(text)


def _polygons(found: Fit) -> str:
    from hitchopt.holding.grip import Grip

    holding, rows = found.holding, []
    for k in range(holding.robots):
        grip, wrap, rest = "–", "–", "–"
        if isinstance(holding.grip, Grip):
            grip = _point(holding.grip.vertices[k, :2])
            wrap = f"{math.degrees(holding.grip.wraps.angles[k]):.1f}"
        if not isinstance(holding.rest, InfeasibleError):
            rest = _point(holding.rest.vertices[k])
        rows.append((f"p{k}", _point(holding.enclosing.vertices[k]), grip, wrap, rest))
    title = f"Polygons of {holding.robots} cables of {holding.cable_length:.2f} m"
    heads = ["enclosing [m]", "gripping [m]", "wrap [°]", "resting [m]"]
    return table(title, ["vertex"], heads, rows)


def _point(point: Iterable[float]) -> str:
    return ", ".join(f"{round(float(x), 3) + 0.0:.3f}" for x in point)


def _masses(found: Fit) -> str:
    words = ["robots", "grip", "limit", "change for more", "rest", "limit", "change for more"]
    grips, rests = found.capacities("grip"), found.capacities("rest")
    rows = [(n, *_capacity(grips[n]), *_capacity(rests[n])) for n in found.others]
    return table("Largest mass", words, [], rows)


def _capacity(found: Capacity | InfeasibleError) -> tuple[str, str, str]:
    if isinstance(found, InfeasibleError):
        broken = found.violations[0]
        return "–", broken.constraint, broken.remedy
    mass = f"{1e3 * found.mass:.0f} g" if found.mass > 0.0 else "–"
    return mass, found.binding, found.suggested
