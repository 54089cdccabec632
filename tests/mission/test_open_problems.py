"""Problems of open chains to plans: laws at samples, and the published script's case."""

import numpy as np
import pytest
from plans import planned
from problem_cases import hitch_start, random_chain

import hitchopt as ho
from hitchopt.mission.loading import problem_from_dict


@pytest.mark.parametrize("n", [2, 5])
def test_chains_of_any_size_are_planned_and_hold_at_dense_samples(n: int) -> None:
    plan = ho.solve(problem_from_dict(random_chain(n, 1)))
    assert plan.certificate.certified
    s = plan.at(np.linspace(0.0, plan.duration, 1501))
    x, p, L = s.positions, s.vertices, plan.motion.team.cable_length
    assert p.shape[1:] == (n + 1, 3)
    np.testing.assert_allclose(x[:, 0], p[:, 0], atol=1e-9)
    np.testing.assert_allclose(x[:, -1], p[:, -1], atol=1e-9)
    assert not np.any(s.legs[:, 0, 0])
    assert not np.any(s.legs[:, -1, 1])
    used = np.linalg.norm(np.diff(p, axis=1), axis=-1)
    used += np.linalg.norm(x[:, 0::2] - p[:, :-1], axis=-1)
    used += np.linalg.norm(x[:, 1::2] - p[:, 1:], axis=-1)
    assert np.max(np.abs(used / L - 1.0)) <= plan.certificate["cable_length"].bound <= 1e-4
    # The forces that setpoints.csv holds balance the cables' at every clasp.
    forces = s.cable_forces.reshape(len(x), n, 2, 3)
    edges = np.diff(p, axis=1)
    pulls = s.tensions[..., None] * edges / np.linalg.norm(edges, axis=-1, keepdims=True)
    for k in range(1, n):
        residual = -forces[:, k, 0] - forces[:, k - 1, 1] + pulls[:, k] - pulls[:, k - 1]
        size = np.max(np.linalg.norm(residual, axis=-1) / np.min(s.tensions[:, k - 1 : k + 1], 1))
        assert size <= plan.certificate["equilibrium"].bound <= 5e-3
    np.testing.assert_allclose(forces[:, 0, 0], pulls[:, 0], atol=1e-9)
    np.testing.assert_allclose(forces[:, -1, 1], -pulls[:, -1], atol=1e-9)


def test_legs_that_leave_no_choice_are_given_and_checked() -> None:
    data = random_chain(3, 10)
    data["mission"] = [{"hold": {"seconds": 1.0}}]
    slack = problem_from_dict(data)
    free = slack.team.cable_length - hitch_start(slack).polygon.edge_lengths
    data["start"]["hitch"]["legs"] = [0, 0.3, round(float(free[2]), 5)]
    state = ho.solve(problem_from_dict(data)).at(0.5)
    np.testing.assert_allclose(state.legs, [[0, free[0]], [0.3, free[1] - 0.3], [free[2], 0]])
    data["start"]["hitch"]["legs"] = [0.3, 0.3, round(float(free[2]), 5)]
    with pytest.raises(ho.InfeasibleError, match=r"q0 stands at the chain's end.*write d_0 = 0"):
        ho.solve(problem_from_dict(data))
    data["start"]["hitch"]["legs"] = [0, 0, 0.3]
    with pytest.raises(ho.InputError, match=r"start\.hitch\.legs\[1\] = 0\.0: must be greater"):
        problem_from_dict(data)


def test_the_published_scripts_case() -> None:
    """Four cables of 5 m, one clasp on a circle of 0.5 m, the other clasps and both ends still."""
    plan = planned("open_chain")
    team = plan.motion.team
    s = plan.at(np.linspace(0.0, plan.duration, 3001))
    p = s.vertices
    assert np.max(np.abs(np.linalg.norm(p[:, 2, :2] - [0.0, 1.7], axis=-1) - 0.5)) < 1e-4
    turned = np.unwrap(np.arctan2(p[:, 2, 1] - 1.7, p[:, 2, 0]))
    assert turned[0] - turned[-1] == pytest.approx(2.0 * np.pi)
    still = [0, 1, 3, 4]
    np.testing.assert_allclose(p[:, still], np.broadcast_to(p[0, still], p[:, still].shape))
    moves = np.max(np.ptp(s.positions, axis=0), axis=1) > 1e-9
    assert {name for name, m in zip(team.drone_names, moves, strict=True) if m} == {
        "r0",
        "r1",
        "q2",
        "q3",
    }
    # Lengths with all three coordinates, which the script forgot one of.
    length = np.linalg.norm(np.diff(p, axis=1), axis=-1) + np.sum(s.legs, axis=-1)
    np.testing.assert_allclose(length, 5.0, atol=1e-5)
