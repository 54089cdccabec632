"""Setpoints that hold the tension: drones that track them follow the plan."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import hitchopt as ho
from hitchopt.checks.drones import largest_rate
from hitchopt.exports.format import format_of
from hitchopt.exports.held_tension import HeldTension, held_tension, trailing_times
from hitchopt.exports.options import HOMES
from hitchopt.exports.placing import ReferenceFrame
from hitchopt.exports.verification import Flown, verify
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from tests.helpers.exported_plans import EACH_FORMAT, reflown

SOFT = ho.Quadrotor(stiffness=4.75)


@pytest.fixture(scope="module")
def plan() -> ho.Plan:
    """A hitch of unequal cables that turns and changes its shape."""
    team = ho.Team(3, [2.6, 2.7, 2.8], tension=[0.4, 0.45, 0.5], quadrotor=SOFT)
    start = ho.Hitch.balanced(team, ho.regular_polygon(3, 1.3).translated([0.3, -0.2]), 1.2)
    wider = ho.regular_polygon(3, 1.1, angle=0.3).translated([0.5, 0.1])
    return ho.morph(start, wider, limits=ho.Limits(speed=0.6))


def flown(
    motion: Motion, held: HeldTension, t: np.ndarray, positions_only: bool = False
) -> np.ndarray:
    """Where drones fly by the setpoints, with the plan's cable forces: m ẍ, integrated.

    What a filter takes for a velocity is a force of the controller, as if cables pulled more.
    """
    sent = 0.0 if positions_only else 1.0
    mass = motion.team.mass
    m, c, k = mass[:, None], held.damping, held.stiffness
    count = motion.team.drones

    def change(now: float, y: np.ndarray) -> np.ndarray:
        x, v = y.reshape(2, count, 3)
        at = min(now, held.flight.duration)
        s, ds, dds = (held.flight.drones.at(at, order) for order in range(3))
        pull = states_at(motion, at).held_forces(motion.team.false_pull)
        force = sent * (m * dds + c * ds) - c * v + k * (s - x) + pull
        return np.concatenate([v.ravel(), (force / m).ravel()])

    begin = np.concatenate([motion.drones.at(0.0).ravel(), np.zeros(3 * count)])
    found = solve_ivp(
        change, (0.0, float(t[-1])), begin, t_eval=t, rtol=1e-8, atol=1e-9, max_step=0.02
    )
    places: np.ndarray = found.y[: 3 * count].T.reshape(len(t), count, 3)
    return places


@pytest.mark.slow
def test_drones_that_fly_by_them_are_where_the_plan_says(plan: ho.Plan) -> None:
    """Level and upright apart, as a flight controller's gains are."""
    gains = {"kp": [4.75, 3.5], "kd": [1.32, 1.0], "ki": 0}
    kinds = (ho.Quadrotor(controller="mellinger", gains=gains),) * 3
    plan = reflown(plan, replace(plan.motion, team=replace(plan.motion.team, quadrotor=kinds)))
    held = held_tension(plan.flight)
    t = np.linspace(0.0, plan.duration, 30)
    away = np.linalg.norm(flown(plan.motion, held, t) - plan.at(t).positions, axis=-1)
    assert np.max(away) < held.error + 1e-6
    assert held.error < 1e-4
    # Setpoints that are moved as at rest only miss the plan by far more.
    still = plan.motion.drones.at(t) - states_at(plan.motion, t).cable_forces / 4.75
    assert np.max(np.linalg.norm(held.flight.drones.at(t) - still, axis=-1)) > 20 * held.error


WIGGLE = 0.004
"""[m]"""


def wiggled(plan: ho.Plan) -> HeldTension:
    """Setpoints of a plan with a sway of 4 mm along x: jerk is continuous at its ends."""
    held = held_tension(plan.flight)
    drones = held.flight.drones
    t = drones.breaks / drones.breaks[-1]
    sway = WIGGLE * np.array([np.sin(np.pi * t) ** 4, *np.zeros((3, len(t)))])
    rise = np.pi / drones.breaks[-1]
    sine, cosine = np.sin(np.pi * t), np.cos(np.pi * t)
    sway[1] = WIGGLE * 4.0 * rise * sine**3 * cosine
    sway[2] = WIGGLE * 4.0 * rise**2 * sine**2 * (3.0 * cosine**2 - sine**2)
    ends = np.zeros((3, len(t), 1, 3))
    ends[..., 0, 0] = sway[:3]
    extra = PiecewisePolynomial.hermite(drones.breaks, ends[:, :-1], ends[:, 1:])
    sum_of = bernstein.elevate(extra.coefficients, drones.degree) + drones.coefficients
    (flown,) = held.flight.teams
    motion = replace(flown.motion, drones=drones.replaced(sum_of))
    return replace(held, flight=replace(held.flight, teams=(replace(flown, motion=motion),)))


@pytest.mark.slow
def test_drones_are_off_by_as_much_as_the_setpoints_in_the_files(plan: ho.Plan) -> None:
    """The law on which the limits of exported motion rest."""
    held = wiggled(plan)
    t = np.linspace(0.0, plan.duration, 30)
    off = flown(plan.motion, held, t) - plan.at(t).positions
    expected = held.flight.drones.at(t) - held_tension(plan.flight).flight.drones.at(t)
    assert np.max(np.abs(expected)) > 0.9 * WIGGLE
    np.testing.assert_allclose(off, expected, atol=held.error + 1e-6)


def test_limits_hold_for_drones_that_follow_the_files(plan: ho.Plan, tmp_path: Path) -> None:
    """Setpoints are faster than their drones, whose plan has almost its speed limit."""
    limits = replace(plan.motion.requirements.limits, tracking=None)
    fastest = plan.certificate["speed"].worst

    def limited(speed: float) -> ho.Plan:
        requirements = replace(plan.motion.requirements, limits=replace(limits, speed=speed))
        return reflown(plan, plan.motion.replaced(requirements=requirements))

    tight = limited(1.0005 * fastest)
    setpoints = held_tension(tight.flight).flight.drones
    assert largest_rate(setpoints, 1).worst > 1.0005 * fastest
    (done,) = tight.export("crazyswarm2", tmp_path)
    (speed,) = (check for check in done.verdict.checks if check.name == "speed")
    assert speed.limit is not None
    assert fastest * 0.999 < speed.worst < speed.limit
    contents = format_of("csv").load(
        [*limited(2.0).export("csv", tmp_path / "c", hold_tension=True)[0].folder.glob("*.csv")]
    )
    flown_by = Flown(held_tension(tight.flight).flight, tight.flight)
    names = contents.names
    assert verify(flown_by, contents, ReferenceFrame(), names).violated == ()
    slow = limited(0.98 * fastest).flight
    broken = verify(Flown(held_tension(slow).flight, slow), contents, ReferenceFrame(), names)
    assert {check.name for check in broken.violated} == {"speed"}
    trailing = verify(
        Flown(held_tension(slow).flight, slow, trails=True), contents, ReferenceFrame(), names
    )
    assert trailing.violated == ()
    assert "trail positions" in trailing.not_carried


def test_at_rest_they_are_moved_outward_by_the_tension_over_the_stiffness(plan: ho.Plan) -> None:
    team = plan.motion.team
    held = held_tension(plan.flight, 6.0, 1.5)
    for t, end in ((0.0, 0.0), (held.flight.duration, plan.duration)):
        states = plan.at(end)
        legs = states.positions - states.vertices[team.layout.anchors]
        outward = legs / np.linalg.norm(legs, axis=-1, keepdims=True)
        pull = np.repeat(team.tension, 2)[:, None]
        moved = held.flight.drones.at(t) - states.positions
        np.testing.assert_allclose(moved, pull * outward / 6.0, atol=1e-5)
    assert held.offset == pytest.approx(0.5 / 6.0, rel=0.05)
    assert held.flight.duration == pytest.approx(plan.duration + 2.0)
    offsets = held_tension(plan.flight).flight.drones.at(0.0) - plan.at(0.0).positions
    found = ho.equilibrium(plan, 0.0, feed_forward=False, offsets=offsets)  # the statics agree
    np.testing.assert_allclose(found.tensions, team.tension, atol=1e-6)
    np.testing.assert_allclose(found.vertices, found.planned_vertices, atol=1e-6)


@pytest.mark.parametrize("name", EACH_FORMAT)
def test_every_format_holds_the_tension(name: str, plan: ho.Plan, tmp_path: Path) -> None:
    (done,) = plan.export(name, tmp_path, hold_tension=True)
    said = json.loads((tmp_path / "export.json").read_text(encoding="utf-8"))
    assert "setpoints hold" in said["feed_forward"] or "hold the tension" in said["feed_forward"]
    names = {check["name"] for check in said["checks"]}
    assert {"separation", "cable_clearance", "speed"} <= names
    assert not names & {"jerk", "body_rate"}
    assert "jerk and body rates are not certified" in said["not_carried"]
    assert "for drones that follow the setpoints, which reach" in said["not_carried"]
    assert any("4.75 N/m" in note for note in done.notes)
    assert said["undetermined_tension"] == []
    (report,) = ho.lint(tmp_path)
    assert report.sound
    # The plan begins in the air, where shows cannot begin
    warned = {f.rule for f in report.findings if f.level == "warning"}
    assert warned == ({"start"} if name == "skybrush" else set())


def test_tables_feed_nothing_forward_and_hold_the_setpoints(plan: ho.Plan, tmp_path: Path) -> None:
    plan.export("parquet", tmp_path, hold_tension=True, rate=50.0)
    table = pq.read_table(tmp_path / "setpoints.parquet")

    def columns(names: str) -> NDArray[np.float64]:
        return np.column_stack([table[name].to_numpy() for name in names.split()])

    assert not np.any(columns("cable_x cable_y cable_z"))
    accelerations = columns("ax ay az")
    np.testing.assert_array_equal(columns("ff_x ff_y ff_z"), accelerations)
    # Attitudes point the thrust along m (a + g ẑ).
    upward = accelerations + [0.0, 0.0, 9.81]
    turned = Rotation.from_quat(columns("qw qx qy qz"), scalar_first=True)
    thrust = upward / np.linalg.norm(upward, axis=-1, keepdims=True)
    np.testing.assert_allclose(turned.apply([0.0, 0.0, 1.0]), thrust, atol=1e-6)
    held = held_tension(plan.flight).flight
    positions = held.drones.at(columns("t")[:: held.team.drones, 0])
    np.testing.assert_allclose(columns("x y z"), positions.reshape(-1, 3), atol=1e-9)


UPLOADED = "crazyswarm2", "compressed", "skybrush"
UNKNOWN, RIGID = "mavsdk_drone_show", {"stiffness": None}
SLACK, INTEGRAL = "Cables will go slack: this receiver takes no cable forces.", "Integral action"


def of_kind(plan: ho.Plan, kind: ho.Quadrotor) -> ho.Plan:
    """Return a plan with other drones."""
    team = replace(plan.motion.team, quadrotor=(kind,) * 3)
    return reflown(plan, replace(plan.motion, team=team))


@pytest.mark.parametrize(
    ("name", "changes", "expected"),
    [
        *((name, {}, []) for name in HOMES if name != "mjcf"),
        *((name, RIGID, []) for name in ("csv", "gltf")),
        ("csv", {"feed_forward": False}, [SLACK]),
        ("csv", {"integral": True}, [INTEGRAL]),
        (UNKNOWN, {"feed_forward": False}, []),
        *((name, RIGID, [SLACK]) for name in (*UPLOADED, UNKNOWN)),
        *((name, {"integral": True}, [INTEGRAL, SLACK]) for name in UPLOADED[1:]),
    ],
)
def test_uploads_hold_the_tension_or_are_refused_and_notes_say_where_it_is_lost(
    name: str, changes: dict[str, Any], expected: list[str], plan: ho.Plan, tmp_path: Path
) -> None:
    other = of_kind(plan, replace(SOFT, **changes))
    if is_refused := bool(expected) and name in (*UPLOADED, UNKNOWN):
        with pytest.raises(ho.InfeasibleError, match=expected[0]):
            other.export(name, tmp_path / "files")
        assert list(tmp_path.iterdir()) == []
    (done,) = other.export(name, tmp_path / "files", allow_slack=is_refused)
    said = json.loads((tmp_path / "files" / "export.json").read_text())["undetermined_tension"]
    assert [reason[: len(words)] for reason, words in zip(said, expected, strict=True)] == expected
    assert set(said) <= set(done.notes)
    assert done.goes_slack == (SLACK in expected)
    (report,) = ho.lint(tmp_path / "files")
    assert [f.message for f in report.findings if f.rule == "tension"] == said


@pytest.mark.parametrize(
    ("name", "stiffness"),
    [*((name, 4.75) for name in UPLOADED), (UNKNOWN, 0.825)],
)
def test_the_stiffness_that_a_refusal_names_holds_the_tension(
    name: str, stiffness: float, plan: ho.Plan, tmp_path: Path
) -> None:
    """The stiffest that the receiver's gains allow for the lightest drone."""
    rigid = of_kind(plan, ho.Quadrotor())
    with pytest.raises(ho.InfeasibleError, match=f"stiffness={stiffness}[,\\. ]"):
        rigid.export(name, tmp_path / "files")
    (done,) = rigid.export(name, tmp_path / "files", stiffness=stiffness)
    assert not done.goes_slack
    manifest = json.loads((tmp_path / "files" / "export.json").read_text())
    assert manifest["undetermined_tension"] == []
    gains = {
        **dict.fromkeys(UPLOADED[:2], ("ctrlMel", "kp_xy", 4.75)),
        UNKNOWN: ("MPC_XY_P", None, 1.5),
    }
    if name in gains:
        group, key, expected = gains[name]
        found = manifest["receiver"]["parameters"]["q1"][group]
        assert (found[key] if key else found) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(
    ("gains", "words"),
    [
        ({"kp": 4.75, "kd": 1.32, "ki": 0.05}, "Set team.quadrotor.gains.ki to 0 and solve again"),
        (None, "Set team.quadrotor.gains to {kp: 4.75, kd: 1.32, ki: 0.0} and solve again"),
    ],
)
def test_integrals_are_refused_with_gains_that_hold_the_tension(
    gains: dict[str, Any] | None, words: str, plan: ho.Plan, tmp_path: Path
) -> None:
    """With the firmware's own gains setpoints would be a metre away, beyond the arena."""
    walls = ho.Arena([-2.2, -2.2, 0.0], [2.2, 2.2, 3.0])
    walled = replace(plan.motion, requirements=replace(plan.motion.requirements, arena=walls))
    other = of_kind(
        reflown(plan, walled),
        ho.Quadrotor(controller="mellinger", gains=gains),
    )
    with pytest.raises(ho.InfeasibleError) as caught:
        other.export("compressed", tmp_path / "files")
    assert words in str(caught.value)
    assert "or add allow_slack=True" in str(caught.value)


def test_allowed_slack_is_used_only_where_tensions_cannot_be_held(
    plan: ho.Plan, tmp_path: Path
) -> None:
    (held,) = plan.export("compressed", tmp_path / "held", allow_slack=True)
    assert not held.goes_slack
    low, high = (
        bound(plan.motion.drones.coefficients, axis=(0, 1, 3)) for bound in (np.min, np.max)
    )
    walls = ho.Arena(low - 0.02, high + 0.02)  # setpoints are 10 cm outward
    near = replace(plan.motion, requirements=replace(plan.motion.requirements, arena=walls))
    with pytest.raises(ho.InfeasibleError, match="setpoints that hold the tension exceed"):
        reflown(plan, near).export("compressed", tmp_path / "near")
    (lost,) = reflown(plan, near).export("compressed", tmp_path / "near", allow_slack=True)
    assert lost.goes_slack
    assert any(note.startswith(SLACK) for note in lost.notes)


def test_set_points_that_come_too_close_are_refused(tmp_path: Path) -> None:
    """Legs that point at a wall: setpoints meet it before the drones do."""
    team = ho.Team(3, 2.0, tension=0.8, quadrotor=SOFT)
    hitch = ho.Hitch.balanced(team, ho.regular_polygon(3, 1.0), 1.0)
    plan = ho.solve(hitch, ho.Hold(1.0), arena=ho.Arena([-1.15] * 2 + [0.0], [1.15, 1.15, 3.0]))
    with pytest.raises(ho.InfeasibleError, match="arena"):
        plan.export("csv", tmp_path / "files", hold_tension=True)
    assert not (tmp_path / "files").exists()


def test_positions_alone_are_certified_for_drones_that_trail_them(
    plan: ho.Plan, tmp_path: Path
) -> None:
    """Without velocities and forces drones are off by less than what is certified."""
    (done,) = plan.export("csv", tmp_path, positions_only=True, damping=1.0)
    check, held = done.verdict.checks[-1], held_tension(plan.flight, None, 1.0)
    t = np.linspace(0.0, plan.duration, 60)
    speed = float(np.max(np.linalg.norm(held.flight.drones.at(t, 1), axis=-1)))
    assert check.name == "tracking_radius"
    assert speed / 4.75 < check.number < 1.5 * speed / 4.75
    assert check.worst == plan.certificate["tracking_radius"].worst
    assert any("trail them by v kd/kp, up to 0.17 m" in note for note in done.notes)
    said = json.loads((tmp_path / "export.json").read_text())["checks"][-1]
    assert (said["name"], said["limit"]) == (check.name, check.limit)
    away = flown(plan.motion, held, t, positions_only=True) - plan.at(t).positions
    largest = np.max(np.linalg.norm(away, axis=-1))
    assert 0.5 * check.number < largest < check.number


def test_positions_alone_are_refused_where_distances_do_not_allow_for_the_lag(
    plan: ho.Plan, tmp_path: Path
) -> None:
    """The stretch that a refusal names suffices, and a smaller one does not."""
    limits = plan.motion.requirements.limits

    def export(tracking: float | ho.Tube, **options: Any) -> None:
        wider = replace(limits, tracking=tracking)
        need = replace(plan.motion.requirements, limits=wider)
        tight = reflown(plan, replace(plan.motion, requirements=need))
        tight.export("skybrush", tmp_path, positions_only=True, **options)

    def refusal(tracking: float | ho.Tube, **options: Any) -> str:
        with pytest.raises(ho.InfeasibleError) as caught:
            export(tracking, **options)
        assert [each.constraint for each in caught.value.violations] == ["tracking_radius"]
        return str(caught.value)

    for tube in (0.12, ho.Tube(0.05, 0.1)):
        factor = float(refusal(tube).split("Add stretch=")[1].split(",")[0])
        assert 1.02 < factor < 3.0
        export(tube, stretch=factor)
        refusal(tube, stretch=1.0 + 0.8 * (factor - 1.0))
    refusal(0.12, allow_slack=True)
    with pytest.raises(ho.InputError, match="omitted for gltf"):
        plan.export("gltf", tmp_path, positions_only=True)
    with pytest.raises(ho.InfeasibleError, match=r"such as stiffness=4\.75"):
        of_kind(plan, ho.Quadrotor()).export("csv", tmp_path, positions_only=True)


@pytest.mark.parametrize("own", [0.02, ho.Tube(0.02, 0.03)])
def test_errors_to_plan_with_are_those_that_positions_alone_need(
    plan: ho.Plan, tmp_path: Path, own: float | ho.Tube
) -> None:
    """They count the trailing once: a plan that keeps distances by less is refused."""
    radius = plan.certificate["tracking_radius"].worst

    def export(tracking: float | ho.Tube, stated: float | ho.Tube | None) -> None:
        need = plan.motion.requirements
        need = replace(need, limits=replace(need.limits, tracking=tracking))
        kinds = tuple(replace(kind, tracking=stated) for kind in plan.motion.team.quadrotor)
        motion = plan.motion.replaced(
            requirements=need, team=replace(plan.motion.team, quadrotor=kinds)
        )
        reflown(plan, motion).export("skybrush", tmp_path, positions_only=True)

    with pytest.raises(ho.InfeasibleError) as caught:
        export(radius - 2e-3, None)
    words = str(caught.value)
    told = float(words.partition("limits.tracking: ")[2].partition(" ")[0])
    assert f"team.quadrotor.tracking: {radius - 2e-3:g}, their errors with full" in words
    assert told > radius  # what the remedy says to plan with
    export(min(told, radius - 1e-6), own)


@pytest.mark.parametrize("ratio", [0.2, 0.44, 0.63, 5.0 / 6.0, 0.999, 1.0, 2.0])
def test_trailing_times_are_the_largest_errors_at_any_speed_up_to_one(ratio: float) -> None:
    """Attained by speeds of ±1 that turn whenever the decay of an error changes its sign."""
    k, m = 4.75, 0.132
    c = 2.0 * ratio * np.sqrt(k * m)
    t = np.linspace(0.0, 120.0 * m / c, 200_001)
    a = np.array([[0.0, 1.0], [-k / m, -c / m]])
    values, vectors = np.linalg.eig(a + 1e-9 * np.array([[0.0, 0.0], [1.0, 0.0]]))
    decay = (vectors[0] * np.linalg.solve(vectors, [1.0, 0.0]) @ np.exp(values[:, None] * t)).real
    expected = np.trapezoid(np.abs(decay), t)
    found = trailing_times(np.array(k), np.array(c), np.array(m))
    assert found == pytest.approx(expected, rel=1e-3)
    assert found >= c / k
