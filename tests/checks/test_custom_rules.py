"""Custom rules: bounds for all t, their places in a certificate, and what is refused."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.checks import CertificateError
from hitchopt.trajectory.enclosed import Enclosed
from hitchopt.values import Array
from tests.helpers.custom_rules import leg_angle
from tests.helpers.groups import two_hitches
from tests.helpers.motions import (
    lines,
    loaded_motion,
    moving,
    random_chain,
    random_curves,
    random_motion,
    single,
    triangle,
    wild_motion,
)
from tests.helpers.plans import planned

CAMERA = np.array([1.5, -2.0, 2.5])  # [m]
AXIS = np.array([0.6, 0.0, 0.8])
NEVER = {"min": 1e6, "max": -1e6}  # limits that every motion violates: their bounds are tight


class Sampled:
    """States of a motion at times, with who is where listed by hand."""

    def __init__(self, motion: ho.Motion) -> None:
        breaks = motion.drones.breaks
        t = np.unique(np.concatenate([np.linspace(breaks[0], breaks[-1], 4001), breaks]))
        self.x, self.v = (motion.drones.differentiated(k).at(t) for k in (0, 1))
        formed = motion.formed[np.clip(np.searchsorted(breaks, t, "right") - 1, 0, None)[:-1]]
        at = t[:-1][formed]
        self.drones = motion.drones.at(at)
        self.p, self.p_rate = (motion.vertices.differentiated(k).at(at) for k in (0, 1))
        n = motion.team.robots
        closed = motion.team.has_cables and motion.team.layout.closed
        self.clasps = range(0 if closed else 1, n)
        self.q_legs = self.drones[:, [2 * k for k in self.clasps]] - self.p[:, self.clasps]
        behind = [2 * ((k - 1) % n) + 1 for k in self.clasps]
        self.r_legs = self.drones[:, behind] - self.p[:, self.clasps]


def degrees(a: Array, b: Array) -> Array:
    """Return the angles between vectors (…, 3)."""
    sine, cosine = np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1)
    angles: Array = np.degrees(np.arctan2(sine, cosine))
    return angles


OF_HITCHES: list[tuple[type[Any], Callable[[Any], Any], Callable[[Sampled], Array]]] = [
    (ho.ClaspSpans, lambda s: s.q_leg.angle_to(s.r_leg), lambda m: degrees(m.q_legs, m.r_legs)),
    (
        ho.ClaspSpans,
        lambda s: s.q_leg.cross(s.r_leg)[2],
        lambda m: np.cross(m.q_legs, m.r_legs)[..., 2],
    ),
    (
        ho.ClaspSpans,
        lambda s: s.q_leg.norm - s.r_leg.norm * 0.5,
        lambda m: np.linalg.norm(m.q_legs, axis=-1) - 0.5 * np.linalg.norm(m.r_legs, axis=-1),
    ),
    (ho.ClaspSpans, lambda s: s.position.dot(AXIS), lambda m: m.p[:, m.clasps] @ AXIS),
    (
        ho.VertexSpans,
        lambda s: (s.position - CAMERA).norm,
        lambda m: np.linalg.norm(m.p - CAMERA, axis=-1),
    ),
    (ho.VertexSpans, lambda s: s.velocity[0], lambda m: m.p_rate[..., 0]),
]
OF_DRONES: list[tuple[type[Any], Callable[[Any], Any], Callable[[Sampled], Array]]] = [
    (
        ho.DroneSpans,
        lambda s: (s.position - CAMERA).norm.inverse,
        lambda m: 1.0 / np.linalg.norm(m.x - CAMERA, axis=-1),
    ),
    (
        ho.DroneSpans,
        lambda s: (CAMERA - s.position).angle_to(AXIS),
        lambda m: degrees(CAMERA - m.x, np.broadcast_to(AXIS, m.x.shape)),
    ),
    (ho.DroneSpans, lambda s: s.velocity.dot(s.velocity), lambda m: np.sum(m.v**2, axis=-1)),
    (ho.DroneSpans, lambda s: s.velocity.xy.norm, lambda m: np.linalg.norm(m.v[..., :2], axis=-1)),
    (ho.DroneSpans, lambda s: 2.0 - s.position[2], lambda m: 2.0 - m.x[..., 2]),
]

HITCHES = {
    "five unequal cables": lambda: random_motion(5, 3),
    "loads and rolled legs": lambda: loaded_motion(2, 4),
    "chain": lambda: random_chain(4, 5),
    "random polynomials": lambda: wild_motion(np.random.default_rng(7), 4, 3, 6, 0.02),
    "tied": lambda: planned("form_square").motion,
    "morph": lambda: planned("unequal_cables").motion,
}
SINGLE = {
    "single drones": lambda: single(random_curves(4, 11, 0.1)),
    "swarm": lambda: planned("swarms/circle_6").motion,
}


def assert_bounded(motion: ho.Motion, quantities: list[Any], gap: float) -> None:
    """Assert that no sample beats the bound of a quantity, which is close to the worst one."""
    samples = Sampled(motion)
    for index, (over, formula, sampled) in enumerate(quantities):
        values = sampled(samples)
        for sense, worst in (("min", np.min(values)), ("max", np.max(values))):
            check = ho.Rule("quantity", "1", sense, NEVER[sense], over, formula).check(motion)
            outside = worst - check.worst if sense == "min" else check.worst - worst
            case = f"{sense} of quantity {index}: {check.worst} for {worst}"
            assert not check.holds
            assert outside >= -1e-9 * max(1.0, abs(worst)), case
            assert outside <= gap * max(1.0, abs(worst)), case
            # A limit that holds is proven with fewer spans, and is not beaten either
            loose = worst - 0.5 if sense == "min" else worst + 0.5
            check = ho.Rule("quantity", "1", sense, loose, over, formula).check(motion)
            outside = worst - check.worst if sense == "min" else check.worst - worst
            assert check.holds, case
            assert outside >= -1e-9 * max(1.0, abs(worst)), case


@pytest.mark.parametrize("name", HITCHES)
def test_samples_of_hitches_beat_no_bound(name: str) -> None:
    gap = 0.05 if name == "random polynomials" else 2e-3
    assert_bounded(HITCHES[name](), OF_HITCHES + OF_DRONES, gap)


@pytest.mark.parametrize("name", SINGLE)
def test_samples_of_single_drones_beat_no_bound(name: str) -> None:
    assert_bounded(SINGLE[name](), OF_DRONES, 0.05)


@pytest.mark.parametrize("name", HITCHES)
def test_formulas_of_limits_give_their_worst_values(name: str) -> None:
    motion = HITCHES[name]()
    certificate = ho.certify(motion)
    upward = [0.0, 0.0, 1.0]
    pairs: list[tuple[str, ho.Rule[Any]]] = [
        ("speed", ho.Rule("v", "m/s", "max", -1.0, ho.DroneSpans, lambda s: s.velocity.norm)),
        (
            "tilt",
            ho.Rule("lean", "deg", "max", -1.0, ho.DroneSpans, lambda s: s.thrust.angle_to(upward)),
        ),
        (
            "vertex_speed",
            ho.Rule("v", "m/s", "max", -1.0, ho.VertexSpans, lambda s: s.velocity.norm),
        ),
    ]
    for limit, rule in pairs:
        assert rule.check(motion).worst == pytest.approx(
            certificate[limit].worst, rel=2e-3, abs=1e-6
        )


def test_rules_appear_in_the_certificate_as_ones_own() -> None:
    motion = planned("triangle").motion
    worst = leg_angle().check(motion).worst
    rules: list[ho.Rule[Any]] = [
        leg_angle(worst - 1.0),
        ho.Rule("high", "m", "max", 0.5, ho.VertexSpans, lambda s: s.position[2]),
    ]
    certificate = ho.certify(motion, rules=rules)
    angle, high = certificate["leg_angle"], certificate["high"]
    assert (angle.holds, angle.custom, angle.limit, angle.where[0][0]) == (
        True,
        True,
        worst - 1.0,
        "p",
    )
    assert (high.holds, [x.name for x in certificate.violated]) == (False, ["high"])
    assert not certificate.certified
    table = str(certificate)
    assert "custom rules:" in table
    assert "custom rules, which hitchopt verify does not prove: leg_angle, high" in table
    assert "hitchopt verify does not prove" in certificate._repr_html_()
    entries = {x["name"]: x for x in json.loads(json.dumps(certificate.to_dict()))["checks"]}
    assert entries["leg_angle"]["custom"] is True
    assert not any("custom" in entries[x.name] for x in ho.certify(motion).checks)
    with pytest.raises(CertificateError, match=r"high: 1 m is above the limit of 0\.5 m at p0"):
        certificate.raise_if_violated()


def test_rules_leave_the_other_checks_and_later_certificates_as_they_are() -> None:
    from hitchopt.checks.certifying import certificate_of

    plan = planned("triangle")
    before = ho.certify(plan)
    after = ho.certify(plan, rules=[leg_angle(1e6)])
    assert after.checks[: len(before.limited)] == before.limited
    assert not after.certified
    assert ho.certify(plan.motion).checks == before.checks
    assert certificate_of(plan.flight).certified
    assert before.to_dict() == ho.certify(plan.flight, rules=()).to_dict()


def test_rules_are_listed_if_there_is_nothing_that_they_limit() -> None:
    certificate = ho.certify(
        lines([[0, 0, 1], [3, 0, 1]], [[0, 1, 1], [3, 1, 1]]), rules=[leg_angle(30.0)]
    )
    (entry,) = (x for x in certificate.to_dict()["checks"] if x["name"] == "leg_angle")
    assert (entry["worst"], entry["holds"], entry["where"]) == (None, True, [])


def test_rules_are_evaluated_for_every_team() -> None:
    flight = two_hitches()
    check = ho.certify(flight, rules=[leg_angle(1e6)], reports=())["leg_angle"]
    each = [leg_angle(1e6).check(team.motion).worst for team in flight.teams]
    assert check.worst == min(each)
    assert check.where[0].split(".")[0] == flight.teams[int(np.argmin(each))].name


def test_bounds_do_not_depend_on_where_a_hitch_is() -> None:
    def angle_at(x: float, y: float, turn: float) -> float:
        corners = np.array([[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]])
        c, s = math.cos(turn), math.sin(turn)

        def outline(t: float) -> Array:
            moved = corners + [[0.0, 0.1 * t], [0.0, 0.0], [0.0, 0.0]]
            turned: Array = moved @ np.array([[c, s], [-s, c]]) + [x, y]
            return turned

        team = ho.Team(3, [2.4, 2.5, 2.3])
        return leg_angle().check(moving(team, outline, [0.3, 0.4, 0.35], seconds=3.0)).worst

    assert angle_at(0.0, 0.0, 0.0) == pytest.approx(angle_at(-3.0, 7.0, 2.0), rel=1e-6)


def test_vectors_that_vanish_have_any_angle() -> None:
    motion = lines([[0, 0, 1]], [[0, 0, 1]])  # at rest: its velocity has no direction
    formula: Callable[[ho.DroneSpans], Any] = lambda s: s.velocity.angle_to(AXIS)  # noqa: E731
    low, high = (
        ho.Rule("heading", "deg", sense, 90.0, ho.DroneSpans, formula).check(motion)
        for sense in ("min", "max")
    )
    assert (low.worst, high.worst) == (0.0, 180.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "Leg angle"}, "name = 'Leg angle': must be lower-case letters"),
        ({"unit": ""}, "unit = '': must be of 1 to 16 characters"),
        ({"sense": "below"}, "sense = 'below': must be min or max"),
        ({"limit": math.nan}, "limit = nan: must be finite"),
        ({"limit": "30"}, "limit = '30': must be a number"),
        ({"over": ho.Motion}, "must be hitchopt.DroneSpans, hitchopt.VertexSpans or"),
        ({"formula": 3.0}, "formula = 3.0: must be a function"),
    ],
)
def test_rules_refuse_invalid_arguments(arguments: dict[str, Any], message: str) -> None:
    valid: dict[str, Any] = {
        "name": "leg_angle",
        "unit": "deg",
        "sense": "min",
        "limit": 30.0,
        "over": ho.ClaspSpans,
        "formula": lambda clasp: clasp.q_leg.norm,
    }
    with pytest.raises(ho.InputError, match=message.replace("(", r"\(")):
        ho.Rule(**(valid | arguments))


@pytest.mark.parametrize(
    ("formula", "message"),
    [
        (lambda s: s.position, r"high.formula = 'of shape \(6, 3\)': must be \(6, 1\)"),
        (lambda s: s.position[2].upper, "must be an enclosed scalar"),
        (lambda _: 1.0, "high.formula = 1.0: must be an enclosed scalar"),
        (
            lambda s: s.place,
            "high.formula = .*'place'.*values of DroneSpans are position, velocity",
        ),
        (lambda s: s.position**2, r"high.formula = TypeError.*: must be a formula; use \+, -"),
        (lambda s: np.linalg.norm(s.position), "high.formula = TypeError.*numpy's functions do"),
        (lambda s: s.position[7], "high.formula = IndexError.*: must be a formula"),
        (lambda s: abs(s.position[2]), "high.formula = TypeError"),
        (lambda: 1.0, "high.formula = TypeError"),
        (lambda s: s.position.length, "high.formula = .*'Enclosed' .* no attribute 'length'"),
        (lambda _: Enclosed.of([1.0]), r"must be \(6, 1\)"),
    ],
)
def test_formulas_that_give_no_number_per_item_are_refused(
    formula: Callable[[Any], Any], message: str
) -> None:
    rule = ho.Rule("high", "m", "max", 2.0, ho.DroneSpans, formula)
    with pytest.raises(ho.InputError, match=message):
        ho.certify(triangle(pieces=1), rules=[rule])


def test_names_of_checks_and_other_rules_are_taken() -> None:
    motion = triangle()
    for name in ("separation", "stoppable", "survivable", "twice"):
        rules = [
            ho.Rule(each, "m", "max", 2.0, ho.DroneSpans, lambda s: s.position[2])
            for each in (name, "twice")
        ]
        with pytest.raises(
            ho.InputError, match="must be different from the names of other checks; rename the rule"
        ):
            ho.certify(motion, rules=rules)
    with pytest.raises(ho.InputError, match=r"rules\[0\] = .*: must be a hitchopt.Rule"):
        ho.certify(motion, rules=[len])  # type: ignore[list-item]
    with pytest.raises(ho.InputError, match="rules"):
        ho.certify(motion, rules=3)  # type: ignore[arg-type]
