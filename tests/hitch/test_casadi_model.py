"""The model in casadi: against arrays, differences, and the polynomials of plans."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

import hitchopt as ho
from hitchopt.hitch.model import FlatJets, drone_jets
from hitchopt.planners.path import cable_along
from hitchopt.values import Array

DERIVATIVES = {"vertices": "vertex", "q_legs": "q_leg", "roll": "roll", "tensions": "tension"}

TEAMS = {
    "triangle": ho.Team(3, 3.5),
    "paper": ho.Team(6, [2.4, 2.5, 2.6, 2.5, 2.4, 2.7]),
    "unequal tensions": ho.Team(4, 3.0, tension=[0.4, 0.41, 0.42, 0.43]),
    "loads": ho.Team(4, 3.0, load=[0.003, 0.004, 0.01, 0.0]),
    "weight and loads": ho.Team(4, 3.0, cable_density=0.004, load=[0.003, 0.0, 0.01, 0.0]),
    "chain": ho.Team(4, 2.0, topology="open"),
    "heavy chain": ho.Team(4, 2.0, topology="open", cable_density=0.003),
}


def random_flat(
    team: ho.Team, seed: int, *, roll: bool, tensions: bool, samples: int = 4
) -> FlatJets:
    """Jets of level hitches near regular ones, off the origin, at no two samples alike."""
    rng, n, layout = np.random.default_rng(seed), team.robots, team.layout
    turn = 2.0 * np.pi / n if layout.closed else np.pi / n
    angles = 0.4 - turn * np.arange(layout.points)  # clockwise
    vertices = np.zeros((samples, layout.points, 3, 4))
    vertices[..., 0] = [0.7, -0.4, 1.1]
    vertices[:, :, :2, 0] += 1.3 * np.column_stack([np.cos(angles), np.sin(angles)])
    vertices[:, :, :2] += 0.05 * rng.normal(size=(samples, layout.points, 2, 4))
    vertices[:, :, 2, 1:] += 0.05 * rng.normal(size=(samples, 1, 3))
    q_legs = 0.03 * rng.normal(size=(samples, n, 4))
    q_legs[..., 0] += 0.45
    pulls = 0.01 * tensions * rng.normal(size=(samples, n, 4))
    pulls[..., 0] += team.tension
    angle = 0.1 * rng.normal(size=(samples, len(layout.clasps), 4)) if roll else None
    return FlatJets(vertices, q_legs, pulls, angle)


def evaluated(team: ho.Team, flat: FlatJets, **options: Any) -> dict[str, Array]:
    """Outputs of ``ho.model`` at the samples of flat outputs, a row each."""
    samples = len(flat.vertices)
    values = {
        "vertices": flat.vertices.reshape(samples, -1, flat.vertices.shape[-1]),
        "q_legs": flat.q_legs,
    }
    if flat.roll is not None:
        values["roll"] = flat.roll
    if options.get("tensions"):
        values["tensions"] = flat.tensions
    inputs = {}
    for name, jets in values.items():
        inputs[name] = jets[..., 0].T
        inputs[f"{DERIVATIVES[name]}_velocities"] = jets[..., 1].T
        inputs[f"{DERIVATIVES[name]}_accelerations"] = jets[..., 2].T
    outputs = ho.model(team, roll=flat.roll is not None, **options).map(samples)(**inputs)
    return {name: np.asarray(each).T for name, each in outputs.items()}


@pytest.mark.parametrize("tensions", [False, True])
@pytest.mark.parametrize("roll", [False, True])
@pytest.mark.parametrize("team", TEAMS.values(), ids=TEAMS)
def test_drones_and_thrusts_are_those_of_arrays(team: ho.Team, roll: bool, tensions: bool) -> None:
    flat = random_flat(team, team.robots, roll=roll, tensions=tensions)
    jets, found = drone_jets(team, flat), evaluated(team, flat, tensions=tensions)
    of_drones = (len(flat.vertices), team.drones, 3)
    for order, name in enumerate(("positions", "velocities", "accelerations")):
        wanted = jets.positions[..., order]
        np.testing.assert_allclose(found[name].reshape(of_drones), wanted, rtol=1e-11, atol=1e-12)
    thrusts = found["thrusts"].reshape(of_drones)
    np.testing.assert_allclose(thrusts, jets.thrusts, rtol=1e-11, atol=1e-12)
    cosines = thrusts[..., 2] / np.linalg.norm(thrusts, axis=-1)
    np.testing.assert_allclose(found["tilt_cosines"], cosines, rtol=1e-12)
    legs = jets.legs[..., 0].reshape(len(cosines), -1)
    np.testing.assert_allclose(found["legs"], legs, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("team", TEAMS.values(), ids=TEAMS)
def test_clasps_balance_and_cables_have_their_length(team: ho.Team) -> None:
    """To the residuals of the series of sag, and of three passes over legs that weigh and rise."""
    found = evaluated(team, random_flat(team, 1, roll=True, tensions=True), tensions=True)
    weighs = team.cable_density > 0.0
    inner = slice(1, -1) if team.topology == "open" else slice(None)  # ends have one leg only
    assert np.max(np.abs(found["cable_residuals"][:, inner])) < (1e-9 if weighs else 1e-13)
    balance = 1e-4 * np.min(team.tension) if weighs else 1e-13
    assert np.max(np.abs(found["clasp_residuals"])) < balance


@pytest.mark.parametrize("name", ["paper", "weight and loads", "heavy chain"])
def test_derivatives_by_time_are_those_of_differences(name: str) -> None:
    team, step = TEAMS[name], 1e-4
    flat = random_flat(team, 5, roll=True, tensions=True, samples=1)
    powers = np.array([1.0, step, step**2 / 2.0, 0.0])

    def moved(sign: float) -> dict[str, Array]:
        """The model a step later or earlier, with third derivatives of zero."""
        signed = powers * [1.0, sign, 1.0, 0.0]
        values = (flat.vertices, flat.q_legs, flat.tensions, flat.roll)
        jets = list[Array]()
        for value in values:
            assert value is not None
            jet = np.zeros_like(value)
            jet[..., 0] = value @ signed
            jet[..., 1] = value[..., 1] + sign * step * value[..., 2]
            jet[..., 2] = value[..., 2]
            jets.append(jet)
        return evaluated(team, FlatJets(*jets), tensions=True)

    now, later, earlier = evaluated(team, flat, tensions=True), moved(1.0), moved(-1.0)
    for value, rate in (("positions", "velocities"), ("velocities", "accelerations")):
        difference = (later[value] - earlier[value]) / (2.0 * step)
        np.testing.assert_allclose(difference, now[rate], rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("name", ["paper", "weight and loads"])
def test_what_casadi_derives_from_it_is_that_of_differences(name: str) -> None:
    """The Jacobian of all outputs by vertices, along a random direction."""
    team, rng, step = TEAMS[name], np.random.default_rng(2), 1e-6
    flat = random_flat(team, 3, roll=False, tensions=False, samples=1)
    model = ho.model(team)
    inputs: dict[str, Any] = {key: ca.SX.sym(key, model.size1_in(key)) for key in model.name_in()}
    outputs = ca.vertcat(*model(**inputs).values())
    direction = rng.normal(size=model.size1_in("vertices"))
    slope = ca.Function(
        "slope",
        [*inputs.values()],
        [outputs, ca.jtimes(outputs, inputs["vertices"], direction)],
        [*inputs],
        ["value", "slope"],
    )
    given = {
        "vertices": flat.vertices[0, ..., 0].ravel(),
        "vertex_velocities": flat.vertices[0, ..., 1].ravel(),
        "vertex_accelerations": flat.vertices[0, ..., 2].ravel(),
        "q_legs": flat.q_legs[0, :, 0],
    }
    after, before = (
        np.asarray(slope(**{**given, "vertices": given["vertices"] + sign * direction})["value"])
        for sign in (step, -step)
    )
    found = np.asarray(slope(**given)["slope"])
    np.testing.assert_allclose((after - before) / (2.0 * step), found, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    "team",
    [
        ho.Team(6, 2.6),
        ho.Team(4, [2.6, 2.5, 2.6, 2.7], cable_density=0.004, load=[0.003, 0.0, 0.005, 0.0]),
    ],
    ids=["paper", "weight and loads"],
)
def test_plans_fly_as_the_model_says(team: ho.Team) -> None:
    """Their stored polynomials: drones, thrusts, tilts, distances and legs at 501 times."""
    n, loose = team.robots, ho.Separation(cable=0.0, crossing=0.0)
    start = ho.Hitch.spread(team, ho.regular_polygon(n, 1.3), separation=loose)
    goal = ho.regular_polygon(n, 1.35).rotated(0.1).translated([0.3, 0.0])
    plan = ho.morph(start, goal, separation=loose)
    motion, times = plan.motion, np.linspace(0.0, plan.duration, 501)
    vertices, drones = (part.jet(times, 3) for part in (motion.vertices, motion.drones))
    tensions = np.zeros((len(times), n, 3))
    tensions[..., 0] = team.tension
    q_legs = cable_along(team, drones[:, 0::2] - vertices, tensions)
    found = evaluated(team, FlatJets(vertices, q_legs, tensions), separation=loose)
    of_drones = (len(times), team.drones, 3)
    for order, (name, bound) in enumerate(
        {"positions": 1e-8, "velocities": 1e-8, "accelerations": 1e-6}.items()
    ):
        error = np.abs(found[name].reshape(of_drones) - drones[..., order])
        assert np.max(error) < bound, name
    checks = plan.certificate
    thrust = np.max(np.linalg.norm(found["thrusts"].reshape(of_drones), axis=-1))
    tilt = np.degrees(np.arccos(np.min(found["tilt_cosines"])))
    closest, shortest = np.min(found["separations"]), np.min(found["legs"])
    for name, worst in (
        ("thrust", thrust), ("tilt", tilt), ("separation", closest), ("legs", shortest)
    ):  # fmt: skip
        assert worst == pytest.approx(checks[name].worst, rel=1e-3), name


def test_pairs_are_those_asked_for_and_names_and_sizes_are_as_documented() -> None:
    team = TEAMS["paper"]
    flat = random_flat(team, 0, roll=False, tensions=False)
    every = evaluated(team, flat)["separations"]
    some = evaluated(team, flat, pairs=[[0, 3], [11, 2]])["separations"]
    order = np.stack(np.triu_indices(12, 1), axis=1).tolist()
    index = np.array([order.index([0, 3]), order.index([2, 11])])
    assert some == pytest.approx(every[:, index], rel=1e-15)
    model = ho.model(team, roll=True, tensions=True, cables=True)
    words = ho.model.__doc__ or ""
    assert all(f"``{name}``" in words for name in (*model.name_in(), *model.name_out()))
    for pairs in ([[0, 12]], [0, 1], [[0.5, 1.0]]):
        with pytest.raises(ho.InputError, match=r"^pairs = "):
            ho.model(team, pairs=pairs)
    with pytest.raises(ho.InputError, match="a team with cables"):
        ho.model(ho.Swarm(3))


def test_cable_lengths_may_be_inputs() -> None:
    team, other = TEAMS["paper"], ho.Team(6, 2.55)
    flat = random_flat(team, 0, roll=False, tensions=False, samples=1)
    given = {"vertices": flat.vertices[0, ..., 0].ravel(), "q_legs": flat.q_legs[0, :, 0]}
    free = ho.model(team, cables=True)(**given, cable_lengths=other.cable_length)
    fixed = ho.model(other)(**given)
    for name, values in fixed.items():
        np.testing.assert_allclose(np.asarray(free[name]), np.asarray(values), atol=1e-14)
