"""Verdicts at every rest of a flight, and their agreement with the evaluation of its recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.lab.simulation.flight import fly
from hitchopt.lab.simulation.judgement import Outcome, judge, vertex_errors
from hitchopt.lab.simulation.planned_rests import STANDING_SPEED, PullTest, pull_tests
from hitchopt.lab.simulation.report import Simulation, ending, summary
from hitchopt.lab.simulation.rests import AFTER, rests
from hitchopt.lab.simulation.settings import INDOOR, Settings
from hitchopt.lab.simulation.task import Task
from tests.helpers.plans import planned
from tests.helpers.scripted import flight_of

TEAM = ho.Team(3, 2.3, tension=0.5, cable_density=0.01)
FROM, TO = ho.regular_polygon(3, 1.3), ho.regular_polygon(3, 1.15)


@pytest.fixture(scope="module")
def plan() -> ho.Plan:
    """A plan of three steps, each of which ends at rest."""
    start = ho.HitchStart(FROM, 2.0)
    return ho.solve(start, [ho.Hold(0.5), ho.Morph(TO), ho.Hold(0.8)], team=TEAM)


def test_every_step_that_ends_with_a_taut_hitch_is_a_rest(plan: ho.Plan) -> None:
    """Errors are those at the step's end: of rests over the rest, of others over a tenth."""
    task = Task.of(plan.flight)
    t = np.arange(0.0, task.duration + 1.005, 0.01)
    states = task.states[np.array([task.index(each) for each in t])]  # type: ignore[index]
    vertices = states.vertices[:, task.team.layout.clasps].copy()
    vertices[:, 1, 0] += 0.03 + 0.01 * (t > plan.phases[0].end)  # p1 is off, more from there on
    off = states.positions + [0.0, 0.03, -0.02]
    flight = flight_of(task, plan.end, t, vertices=vertices, drones=off, rested=task.duration + 1.0)
    found = rests(flight, Outcome((), ()))
    ends = [phase.end for phase in plan.phases[:-1]]
    assert [rest.phase for rest in found] == ["hold", "morph", AFTER]
    np.testing.assert_allclose([rest.end for rest in found], [*ends, flight.rested])
    np.testing.assert_allclose([rest.end - rest.start for rest in found], [0.5, 0.1, 1.0])
    for rest, error in zip(found, (0.03, 0.04, 0.04), strict=True):
        assert rest.vertices["p1"].mean == pytest.approx(error)
        assert rest.vertices["p1"].largest == pytest.approx(error)
        assert rest.vertices["p0"].mean == pytest.approx(0.0, abs=1e-12)
        np.testing.assert_allclose(rest.drones, [0.03, 0.02])
        assert not rest.hitched  # straight cables are not linked


def test_rests_between_which_nothing_moves_have_one_pull_test(plan: ho.Plan) -> None:
    """The last one is pulled after the plan, with the morph's end before it."""
    task = Task.of(plan.flight)
    hold, morph = (phase.end for phase in plan.phases[:-1])
    tests = pull_tests(task)
    assert tests[hold] == PullTest(hold, 0.0)
    assert tests[morph].time == task.duration
    since = tests[morph].since  # as drones slow down to stand, which swing lets them do only gently
    speeds = np.linalg.norm(plan.at([since - 0.02, since]).velocities, axis=-1).max(axis=-1)
    assert speeds[1] <= STANDING_SPEED < speeds[0]
    offsets = plan.at(since).positions - plan.at(morph).positions
    assert since < morph
    assert np.max(np.linalg.norm(offsets, axis=-1)) < 2e-4
    twice = ho.solve(
        ho.HitchStart(FROM, 2.0), [ho.Hold(0.3), ho.Hold(0.2), ho.Morph(TO)], team=TEAM
    )
    first, second = (phase.end for phase in twice.phases[:2])
    assert pull_tests(Task.of(twice.flight)) == dict.fromkeys(
        [first, second], PullTest(second, 0.0)
    )


def test_a_vertex_that_slips_where_it_is_pulled_does_not_hold(plan: ho.Plan) -> None:
    task, end = Task.of(plan.flight), plan.phases[0].end
    index, vertices = task.index(end), task.states.vertices[:, task.team.layout.clasps]
    stopped, t = task.until(index), np.arange(0.0, 3.505, 0.01)
    pulled = np.repeat(vertices[index][None], len(t), axis=0)
    pulled[t > 1.6, 1] += [0.0, 0.3, 0.0]
    linked = np.ones((3, 3), dtype=np.int64)
    times = {"linking": linked, "rested": 1.5, "pulled": 3.5}
    test = flight_of(stopped, plan.end, t, vertices=pulled, **times)
    t = np.arange(0.0, task.duration + 1.005, 0.01)
    whole = flight_of(
        task, plan.end, t, rested=task.duration + 1.0, linking=linked, pull_tests={end: test}
    )
    outcome = judge(whole)
    (failure,) = outcome.failures
    assert (failure.kind, failure.where, failure.time) == ("slipped", ("p1",), end)
    assert f"at rest at t = {end:.2f} s" in failure.words
    assert ending(Simulation.judged(whole)).endswith(f", but {failure.words}")
    found = rests(whole, outcome)
    assert [vertex.holds for vertex in found[0].vertices.values()] == [True, False, True]
    assert found[0].vertices["p1"].moved > 0.1
    assert summary(Simulation.judged(whole))["rests"][0]["vertices"]["p1"]["holds"] is False


@pytest.mark.slow
@pytest.mark.parametrize("controller", ["ideal", "mellinger"])
def test_pull_tests_leave_the_flight_as_it_is(controller: str) -> None:
    """They fly a copy, so that every number of the record is the same without them."""
    nearby = ho.regular_polygon(3, 1.28)
    plan = ho.solve(
        ho.HitchStart(FROM, 2.0), [ho.Hold(0.1), ho.Morph(nearby), ho.Hold(0.3)], team=TEAM
    )
    task, estimator = Task.of(plan.flight), "ideal" if controller == "ideal" else "crazyflie"
    options = {"controller": controller, "estimator": estimator, "perturbations": INDOOR}
    pulled, plain = (fly(task, Settings(pull_test=each, **options)) for each in (True, False))  # type: ignore[arg-type]
    assert [*pulled.pull_tests] == [plan.phases[0].end]
    assert not plain.pull_tests
    for name, values in vars(plain.record).items():
        same = getattr(pulled.record, name)[: len(values)]
        np.testing.assert_array_equal(same, values, err_msg=name)
    assert [rest.hitched for rest in rests(pulled, judge(pulled))] == [True, True, True]


@pytest.mark.slow
def test_a_hitch_that_holds_does_so_at_every_rest(plan: ho.Plan, tmp_path: Path) -> None:
    """The evaluation of the recording finds the vertices of the simulation to a millimetre."""
    simulation = Simulation.of(Task.of(plan.flight), Settings(pull_test=False))
    found = simulation.rests
    assert [rest.phase for rest in found] == ["hold", "morph", AFTER]
    assert all(rest.hitched for rest in found)
    assert summary(simulation)["rests"][1]["vertices"]["p0"]["holds"]
    errors, outcome = vertex_errors(simulation.flight), judge(simulation.flight)
    assert {clasp.name for clasp in outcome.clasps} == {*found[-1].vertices}
    last = (errors.t > found[-1].start + 1e-6) & (errors.t <= found[-1].end + 1e-6)
    for c, vertex in enumerate(found[-1].vertices.values()):
        assert vertex.mean == pytest.approx(np.mean(errors.errors[last, c]))
    folder = simulation.save(tmp_path / "simulation")
    evaluation = ho.evaluate(folder, plan)
    during = errors.t <= plan.duration
    for c in range(3):
        own, theirs = errors.errors[during, c], evaluation.errors[:, c]
        assert np.nanmean(theirs) == pytest.approx(np.nanmean(own), abs=1e-3)
        assert np.nanmax(theirs) == pytest.approx(np.nanmax(own), abs=3e-3)


@pytest.mark.slow
def test_plans_that_end_untied_have_rests_before() -> None:
    motion = planned("tie_carry_untie").flight
    simulation = Simulation.of(Task.of(motion), Settings())
    found = simulation.rests
    assert found
    assert all(rest.hitched for rest in found)
    assert all(np.isfinite(vertex.moved) for rest in found for vertex in rest.vertices.values())
    assert AFTER not in {rest.phase for rest in found}
    assert all(rest.objects or not motion.requirements.objects for rest in found)
