"""Taut parts of cables are catenaries, as integrated along them, and their bounds hold."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hitchopt.values import Array
from hitchopt.verify import parts
from hitchopt.verify.arithmetic import Curve, Effort, Line, norm
from hitchopt.verify.reading import read
from hitchopt.verify.spans import Spans, prove
from hitchopt.verify.statics import Rest, rests
from tests.helpers.plans import planned

COUNT = 40

pytestmark = pytest.mark.filterwarnings("ignore:.*encountered in:RuntimeWarning")
"""Proofs ignore what they cannot bound, as the direction of a chord that may vanish."""


def random_parts(seed: int = 3) -> tuple[Array, Array, Array]:
    """Return chords (COUNT, 3) [m], tensions (COUNT, 1) [N] and weights (COUNT, 1) [N/m].

    Level ones sag by up to a tenth of their span; some are steep, upward or downward.
    """
    rng = np.random.default_rng(seed)
    slope = rng.uniform(-1.3, 1.3, (COUNT, 1))
    slope[:6] = [[0.0], [0.0], [1.5], [-1.5], [1.5707], [-1.5707]]
    azimuth, size = rng.uniform(-3.0, 3.0, (COUNT, 1)), rng.uniform(0.1, 3.0, (COUNT, 1))
    level = np.column_stack([np.cos(azimuth), np.sin(azimuth)]) * np.cos(slope)
    chord = size * np.column_stack([level, np.sin(slope)])
    tension = rng.uniform(0.3, 2.0, (COUNT, 1))
    heaviness = rng.uniform(0.01, 0.35, (COUNT, 1))  # of half a part over its mean tension
    heaviness[0] = 0.35
    mean = tension / (1.0 - heaviness * np.sin(slope))
    return chord, tension, 2.0 * heaviness * mean / size


def still(x: Array) -> Line:
    """Return values (m, d) that are constant on spans of 1 s."""
    return Line(x, 0.0 * x, np.zeros(len(x)), np.full(len(x), 0.5))


def along(first: Array, length: float, weight: float, shares: Array) -> Array:
    """Return points (3, shares) [m] along a cable from its tension [N] at its first end.

    They follow from its directions, whose tension changes by the weight of what hangs below.
    """

    def direction(s: float, _: Array) -> Array:
        F = first + np.array([0.0, 0.0, weight * s])
        return np.asarray(F / np.linalg.norm(F))

    at = shares * length
    points = solve_ivp(direction, (0.0, length), np.zeros(3), t_eval=at, rtol=1e-11, atol=1e-12).y
    return np.asarray(points)


def test_parts_are_what_integrates_along_cables() -> None:
    chord, tension, weight = random_parts()
    part = parts.taut_part(still(chord), still(tension), still(weight / tension))
    assert norm(part.first.v) == pytest.approx(tension[:, 0], rel=1e-12)
    assert norm(part.second.v) == pytest.approx((tension + weight * chord[:, 2:])[:, 0], rel=1e-12)
    for k in range(COUNT):
        length = float(part.length.v[k, 0])
        end = along(part.first.v[k], length, float(weight[k, 0]), np.ones(1))[:, 0]
        assert end == pytest.approx(chord[k], abs=1e-9)
        weighs = part.second.v[k] - part.first.v[k]
        assert weighs == pytest.approx([0.0, 0.0, weight[k, 0] * length], rel=1e-12)
    alone = parts.taut_length(still(chord), still(weight / tension))
    assert alone.v == pytest.approx(part.length.v, rel=1e-14)


def test_light_parts_are_straight() -> None:
    chord, tension, _ = random_parts()
    light = parts.taut_part(still(chord), still(tension), still(1e-9 + 0.0 * tension))
    none = parts.taut_part(still(chord), still(tension), None)
    for part in (light, none):
        assert part.length.v[:, 0] == pytest.approx(norm(chord), rel=1e-12)
        pull = tension * chord / norm(chord)[:, None]
        assert part.first.v == pytest.approx(pull, abs=1e-8)
    vanishing = parts.taut_length(still(0.0 * chord), still(tension))
    assert not np.any(vanishing.v)


def test_the_tension_at_an_end_and_the_length_set_the_chord() -> None:
    chord, tension, _ = random_parts()
    weight = 0.1
    ratio = still(weight / tension)
    part = parts.taut_part(still(chord), still(tension), ratio)
    assert parts.chord_of(part.first, part.length, weight).v == pytest.approx(chord, abs=1e-12)
    straight = parts.taut_part(still(chord), still(tension), None)
    assert parts.chord_of(straight.first, straight.length, 0.0).v == pytest.approx(chord, abs=1e-12)


def test_parts_are_above_what_is_told_of_their_depth() -> None:
    chord, tension, weight = random_parts()
    ratio = still(weight / tension)
    part = parts.taut_part(still(chord), still(tension), ratio)
    depth = parts.depth_below(still(chord), ratio)
    shares = np.linspace(0.0, 1.0, 801)
    for k in np.flatnonzero(norm(chord[:, :2]) > 1e-2):
        points = along(part.first.v[k], float(part.length.v[k, 0]), float(weight[k, 0]), shares)
        at = points[:2].T @ chord[k, :2] / (chord[k, :2] @ chord[k, :2])  # share of the chord
        below = at * chord[k, 2] - points[2]
        told = np.interp(at, [0.0, 0.25, 0.75, 1.0], [0.0, *[depth.v[k, 0]] * 2, 0.0])
        assert np.all(below <= told + 1e-9)
        assert depth.v[k, 0] < 1.2 * np.max(below)


def test_no_part_hangs_where_its_tension_is_too_small() -> None:
    """A level cable of tension T spans at most 1.3255 T / w: the most of ``2 σ / cosh σ``."""
    longest = 1.3254868
    spans = np.array([[longest - 1e-5, 0.0, 0.0], [longest + 1e-5, 0.0, 0.0]])
    length = parts.taut_length(still(spans), still(np.ones((2, 1)))).v[:, 0]
    assert np.isfinite(length[0])
    assert np.isnan(length[1])
    plan: Any = SimpleNamespace(
        h=np.ones(1), breaks=np.arange(2.0), effort=Effort(10**6), only=(), size=1.0
    )
    first = np.zeros(1, dtype=int)
    s = Spans(plan, first, first[:, None], np.full(1, 0.5), np.full(1, 0.5), (["q0"],))
    row = prove(
        "length m min", 0.0, s, lambda s, _: parts.taut_length(s.zero + spans[1], s.zero + 1.0)
    )
    assert row.verdict == "violated"


FORMULAS: dict[str, Callable[[Line, Line, Line], Line]] = {
    "length": lambda chord, T, ratio: parts.taut_part(chord, T, ratio).length,
    "first": lambda chord, T, ratio: parts.taut_part(chord, T, ratio).first,
    "second": lambda chord, T, ratio: parts.taut_part(chord, T, ratio).second,
    "depth": lambda chord, _, ratio: parts.depth_below(chord, ratio),
    "stretch": lambda chord, _, ratio: parts.stretch(chord, ratio),
    "chord": lambda chord, T, ratio: parts.chord_of(
        parts.taut_part(chord, T, ratio).first, chord.norm(), 0.2
    ),
}


@pytest.mark.parametrize("name", FORMULAS)
@pytest.mark.parametrize("width", [0.5, 0.1, 0.01])
def test_no_value_is_beyond_its_bounds(name: str, width: float) -> None:
    """Values are bounded by deviations, and slopes, by differences, by theirs."""
    rng = np.random.default_rng(11)
    m = 30
    h = np.full(m, 0.2)
    plan: Any = SimpleNamespace(h=h, breaks=np.arange(m + 1.0) * 0.2, effort=Effort(10**7))
    chord, _, _ = random_parts()
    ends = chord[:m, None, :, None] + 0.05 * np.cumsum(rng.normal(size=(m, 1, 3, 6)), axis=-1)
    points = Curve(ends, h)
    T = Curve(1.5 + 0.05 * np.cumsum(rng.normal(size=(m, 1, 1, 6)), axis=-1), h)
    piece, item = np.arange(m), np.zeros((m, 1), dtype=int)
    whole = Spans(plan, piece, item, np.full(m, 0.5), np.full(m, 0.5 * width))

    def value(s: Spans) -> Line:
        tension = T.on(s, 0)
        return FORMULAS[name](points.on(s, 0), tension, tension.inverse() * 0.2)

    bound = value(whole)
    finite = np.isfinite(bound.q)
    assert np.all(finite) or width > 0.1
    for share in np.linspace(-1.0, 1.0, 21):
        there = value(whole.subspan(float(share)))
        assert not np.any((norm(there.v - bound.v) > bound.deviation + 1e-12) & finite)
        assert not np.any((norm(there.g - bound.g) > bound.q + 1e-9) & finite)
    middle = value(whole.subspan(0.0))
    step = 1e-3 / width
    before, after = (value(whole.subspan(side * step)).v for side in (-1.0, 1.0))
    slope = (after - before) / (2.0 * step * whole.t[:, None])
    assert slope == pytest.approx(middle.g, abs=1e-5)


@pytest.fixture(scope="module")
def rest(tmp_path_factory: pytest.TempPathFactory) -> Rest:
    """A hitch of cables that sag, with friction of legs."""
    folder = tmp_path_factory.mktemp("rest")
    planned("weight_hexagon").save(folder)
    ((plan,), _) = read(folder / "plan.npz")
    return next(rests(plan))[1]


def test_spans_at_rest_are_what_integrates_along_cables() -> None:
    chord, tension, weight = random_parts(4)
    tension = tension / weight * 0.2
    heavy: Any = SimpleNamespace(weight=0.2, exists=np.ones((COUNT, 1), dtype=bool))
    heavy.heights = np.zeros(COUNT)
    ends = np.stack([0.0 * chord, chord], axis=1)
    pull, down, length = Rest.spans(heavy, ends, tension)
    for k in range(COUNT):
        first = (pull - down)[k, 0]
        assert np.linalg.norm(first) == pytest.approx(tension[k, 0], rel=1e-12)
        end = along(first, float(length[k, 0]), 0.2, np.ones(1))[:, 0]
        assert end == pytest.approx(chord[k], abs=1e-9)
        assert down[k, 0] == pytest.approx([0.0, 0.0, 0.1 * length[k, 0]])


def test_complex_steps_are_slopes(rest: Rest) -> None:
    """All cables sag, and errors of every kind act on them."""
    rng = np.random.default_rng(2)
    unknowns = np.concatenate([rest.planned.ravel(), rest.tensions])
    unknowns = unknowns + 0.01 * rng.normal(size=len(unknowns))
    errors = 0.01 * rng.normal(size=len(rest.errors))
    errors[-2 * len(rest.tensions) :] += 0.1
    bends = rest.bends(unknowns)
    step = 1e-6
    for by, at in zip(rest.slopes(unknowns, errors), (unknowns, errors), strict=True):
        assert by.shape == (len(unknowns), len(at))
        for k in range(len(at)):
            ends = []
            for sign in (-1.0, 1.0):
                moved = at.copy()
                moved[k] += sign * step
                if at is unknowns:
                    ends.append(rest.balance(moved, errors, bends))
                else:
                    ends.append(rest.balance(unknowns, moved, bends))
            slope = (ends[1] - ends[0]) / (2.0 * step)
            assert by[:, k] == pytest.approx(slope, rel=1e-6, abs=1e-7)
