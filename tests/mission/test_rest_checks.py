"""Hitches at rest: what is seen without a certificate, and what is said where a motion fails."""

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.requirements import Requirements
from hitchopt.steps.certified_motions import certificate_at_rest, seems_to_rest

TEAM = ho.Team(3, 2.4)
TRIANGLE = ho.regular_polygon(3, 1.3)


def hitch(team: ho.Team = TEAM, legs: float = 0.55) -> ho.Hitch:
    return ho.Hitch(team, TRIANGLE, 1.0, np.full(3, legs))


def test_a_hitch_that_seems_to_rest_is_certified_at_rest() -> None:
    assert seems_to_rest(hitch(), Requirements())
    assert certificate_at_rest(hitch(), Requirements()).certified


@pytest.mark.parametrize(
    ("given", "requirements"),
    [
        (hitch(legs=0.2), Requirements(ho.Limits(leg=0.25))),
        (hitch(), Requirements(ho.Limits(tilt=0.2))),
        (hitch(), Requirements(separation=ho.Separation(radius=0.6))),
        (hitch(), Requirements(arena=ho.Arena([-0.6, -2.0, 0.0], [2.0, 2.0, 3.0]))),
        (hitch(ho.Team(3, 2.4, quadrotor=ho.Quadrotor(0.132, 1.31))), Requirements()),
    ],
    ids=["leg", "tilt", "separation", "arena", "thrust"],
)
def test_what_breaks_a_limit_at_rest_does_not_seem_to_rest(
    given: ho.Hitch, requirements: Requirements
) -> None:
    assert not certificate_at_rest(given, requirements).certified
    assert not seems_to_rest(given, requirements)


@pytest.mark.parametrize("optimize", [False, True])
def test_refusals_name_the_end_where_only_a_certificate_finds_it_broken(
    monkeypatch: pytest.MonkeyPatch, *, optimize: bool
) -> None:
    separation = ho.Separation(radius=0.6)
    for module in ("hitchopt.steps.hitch_step", "hitchopt.mission.solving"):
        monkeypatch.setattr(f"{module}.seems_to_rest", lambda *_: True)
    with pytest.raises(ho.InfeasibleError, match=r"separation: .* at the start \(t = 0\)"):
        ho.morph(hitch(), TRIANGLE.scaled(1.05), separation=separation, optimize=optimize)
    arena = ho.Arena([-1.6, -1.6, 0.0], [1.6, 1.6, 3.0])
    goal = TRIANGLE.translated([0.9, 0.0])
    with pytest.raises(ho.InfeasibleError, match=r"arena: .* at the end of step 0 \(morph\)"):
        ho.morph(hitch(), goal, arena=arena, optimize=optimize)
