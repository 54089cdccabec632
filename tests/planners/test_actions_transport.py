"""Transport: the whole hitch carried and turned, rigidly, as asked."""

from __future__ import annotations

import numpy as np
import pytest

import hitchopt as ho

START = ho.Hitch(
    ho.Team(
        4,
        [2.1, 2.2, 2.15, 2.1],
        tension=[0.4, 0.42, 0.41, 0.4],
        cable_density=0.003,
        quadrotor=[ho.Quadrotor(0.13 + 0.01 * k, 2.6) for k in range(4)],
    ),
    [[2.6, 1.0], [2.5, -0.1], [1.4, -0.2], [1.5, 1.1]],
    1.3,
    [0.5, 0.55, 0.45, 0.5],
)


def centroid(points: np.ndarray) -> np.ndarray:
    """Of the area, by a fan of triangles about the origin of coordinates."""
    following = np.roll(points, -1, axis=0)
    double = points[:, 0] * following[:, 1] - points[:, 1] * following[:, 0]
    return np.asarray(((points + following) * double[:, None]).sum(axis=0) / (3.0 * double.sum()))


@pytest.mark.parametrize("yaw", [0.0, 0.6, -4.7, 4.0 * np.pi])
def test_the_centroid_goes_straight_and_the_hitch_turns_all_the_way(yaw: float) -> None:
    to = np.array([1.2, 1.4, 1.9])
    plan = ho.transport(START, to, yaw=yaw)
    state = plan.at(np.linspace(0.0, plan.duration, 601))
    middle = np.array([centroid(p[:, :2]) for p in state.vertices])
    first = np.array([*centroid(START.polygon.vertices), 1.3])
    np.testing.assert_allclose(middle[-1], to[:2], atol=1e-9)
    gone = np.column_stack([middle, state.vertices[:, 0, 2]]) - first
    line = (to - first) / np.linalg.norm(to - first)
    np.testing.assert_allclose(gone, (gone @ line)[:, None] * line, atol=1e-6)
    np.testing.assert_allclose(state.vertices[-1, :, 2], 1.9, atol=1e-12)
    edge = state.vertices[:, 1] - state.vertices[:, 0]
    turned = np.unwrap(np.arctan2(edge[:, 1], edge[:, 0]))
    assert turned[-1] - turned[0] == pytest.approx(yaw, abs=1e-9)
    # Turning and going share one clock.
    share = gone @ line / np.linalg.norm(to - first)
    np.testing.assert_allclose(turned - turned[0], share * yaw, atol=1e-5)


def test_thrust_holds_weight_pull_and_acceleration_on_the_climb() -> None:
    plan = ho.transport(START, [*START.polygon.centroid, 2.1])
    state = plan.at(np.linspace(0.0, plan.duration, 2001))
    team = START.team
    leg = state.positions - np.repeat(state.vertices, 2, axis=1)
    leg[:, 1::2] = state.positions[:, 1::2] - np.roll(state.vertices, -1, axis=1)
    length, half = np.linalg.norm(leg, axis=-1), 0.5 * 9.81 * 0.003
    pull = np.repeat(team.tension, 2) + half * leg[..., 2]  # tension grows with height
    weight = 9.81 * team.mass + half * length
    thrust = team.mass[:, None] * state.accelerations + (pull / length)[..., None] * leg
    thrust[..., 2] += weight
    largest = float(np.max(np.linalg.norm(thrust, axis=-1)))
    assert plan.certificate["thrust"].worst == pytest.approx(largest, rel=1e-3)
    assert largest > np.max(np.hypot(weight, np.repeat(team.tension, 2))) + 0.1  # more than at rest


def test_where_it_cannot_go_is_told() -> None:
    arena = ho.Arena([-4, -4, 0], [4, 4, 2])
    with pytest.raises(ho.InfeasibleError, match=r"arena: .*end of step 0 \(transport\)"):
        ho.transport(START, [1.2, 1.4, 2.1], arena=arena)
    with pytest.raises(ho.InfeasibleError, match=r"arena: .* in step 0 \(transport\)"):
        # Both ends are inside; half way through the turn a corner's drone is not.
        ho.transport(START, [*START.polygon.centroid, 1.3], yaw=2.0 * np.pi, arena=inside(START))


def inside(hitch: ho.Hitch) -> ho.Arena:
    """A box just about the hitch as it stands."""
    drones = hitch.drones
    return ho.Arena(drones.min(axis=0) - 0.02, drones.max(axis=0) + 0.02)
