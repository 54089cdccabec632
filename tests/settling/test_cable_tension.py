"""The law of a cable: its lengths, tensions, energies, and their derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchopt.hitch.catenary import Catenary
from hitchopt.settling.cable_tension import CableLaw, Spans, least_tension

NODES = np.random.default_rng(5).normal(size=(3, 4, 3)) * 0.1 + np.array(
    [[[-0.4, 0.1, 1.1], [0, 0, 1], [1.2, 0.1, 0.9], [1.5, 0.5, 1.2]]]
)
"""(3, 4, 3) [m], nodes of three cables."""

EXIST = np.array([[True, True, True], [True, True, True], [False, True, True]])


def spans(nodes: np.ndarray = NODES) -> Spans:
    ends = nodes.copy()
    ends[2, 1] = ends[2, 0]  # a chain's end
    return Spans.between(ends, EXIST)


def law(weight: float, spare: float = 0.01, stiffness: float = 1e4) -> CableLaw:
    chords = spans().chords
    lengths = np.sum(chords, axis=-1) + spare
    reference, heights = np.array([0.4, 0.5, 0.6]), np.array([1.03, 0.97, 1.0])
    least = least_tension(weight, chords)
    return CableLaw(lengths, weight, lengths / stiffness, reference, heights, least)


@given(st.floats(0.005, 0.2), st.floats(-0.02, 0.2))
def test_chords_arcs_and_stretch_are_the_length(weight: float, spare: float) -> None:
    cable, found = law(weight, spare), spans()
    T = cable.tensions(found)
    taut = ~cable.slack(T)
    length = np.sum(found.chords + cable.arcs(found, T), axis=-1)
    real = cable.lengths + cable.compliance * (T - cable.reference)
    np.testing.assert_allclose(length[taut], real[taut], rtol=1e-12)
    assert np.all(T[~taut] == cable.least[~taut])
    assert np.all(length[~taut] <= real[~taut] + 1e-12)


def test_a_slack_cable_without_weight_does_not_pull_and_a_taut_one_as_a_spring() -> None:
    slack, taut = law(0.0, 0.01, 500.0), law(0.0, -0.002, 500.0)
    assert np.all(slack.tensions(spans()) == 0.0)
    assert np.all(slack.slack(slack.tensions(spans())))
    expected = taut.reference + 0.002 * 500.0 / taut.lengths
    np.testing.assert_allclose(taut.tensions(spans()), expected, rtol=1e-12)


def test_longer_cables_pull_less_until_they_are_slack() -> None:
    found = [law(0.05, spare).tensions(spans()) for spare in np.linspace(-0.01, 0.6, 50)]
    assert np.all(np.diff(found, axis=0) <= 0.0)
    assert np.all(np.diff(found, axis=0)[:10] < 0.0)
    assert np.all(law(0.05, 0.6).slack(found[-1]))


@pytest.mark.parametrize("weight", [0.03, 0.1])
def test_spans_are_catenaries(weight: float) -> None:
    """Forces and tensions are those of the exact curve of this length, to 0.13 (w s/m)²."""
    cable, found = law(weight), spans()
    T = cable.tensions(found)
    assert not np.any(cable.slack(T))
    arcs, m = cable.arcs(found, T), cable.middle_tensions(found, T)
    pulls, weights = cable.pulls(found, T), cable.weights(found, T)
    starts, ends = NODES[:, :-1], NODES[:, 1:]
    for k, p in zip(*np.nonzero(EXIST & (found.chords > 0.3)), strict=True):
        first, second = (
            (NODES[2, 0], NODES[2, 2]) if (k, p) == (2, 1) else (starts[k, p], ends[k, p])
        )
        curve = Catenary.between(first, second, found.chords[k, p] + arcs[k, p])
        exact = weight * curve.pull(first, second)
        ratio = weight * found.chords[k, p] / m[k, p]
        ours = pulls[k, p]
        half = np.array([0.0, 0.0, -0.5 * weights[k, p]])
        np.testing.assert_allclose(ours + half, exact[0], atol=0.16 * ratio**2 * m[k, p])
        np.testing.assert_allclose(-ours + half, exact[1], atol=0.16 * ratio**2 * m[k, p])
        # Tension grows with height: at the first end it is that of the middle and the difference.
        size = m[k, p] + weight * (first[2] - found.middles[k, p])
        assert np.linalg.norm(exact[0]) == pytest.approx(size, abs=0.16 * ratio**2 * m[k, p])


@pytest.mark.parametrize(
    ("weight", "spare"), [(0.0, -0.004), (0.03, 0.01), (0.1, 0.01), (0.1, 0.6)]
)
def test_derivatives_agree_with_finite_differences(weight: float, spare: float) -> None:
    cable, h = law(weight, spare), 1e-6
    T = cable.tensions(spans())
    assert np.all(cable.slack(T)) == (spare > 0.5)

    def total(nodes: np.ndarray) -> np.ndarray:
        found = spans(nodes)
        return cable.energies(found, cable.tensions(found))

    for node in range(4):
        for axis in range(3):
            step = np.zeros((4, 3))
            step[node, axis] = h
            slope = (total(NODES + step) - total(NODES - step)) / (2 * h)
            found = spans()
            pulls, weights = cable.pulls(found, T), cable.weights(found, T)
            before = node - 1 if node > 0 else None
            after = node if node < 3 else None
            ours = np.zeros(3)
            if before is not None:
                ours += pulls[:, before, axis] + 0.5 * weights[:, before] * (axis == 2)
            if after is not None:
                ours += -pulls[:, after, axis] + 0.5 * weights[:, after] * (axis == 2)
            np.testing.assert_allclose(ours[:2], slope[:2], rtol=1e-6, atol=1e-7)
    lengths = [
        replace(cable, lengths=cable.lengths + sign * h).tensions(spans()) for sign in (1.0, -1.0)
    ]
    slopes = (lengths[0] - lengths[1]) / (2 * h)
    np.testing.assert_allclose(-cable.length_slopes(spans(), T), slopes, rtol=1e-4)


@pytest.mark.parametrize("lower", [0.0, 0.3, 0.6])
def test_lengths_are_met_where_a_low_span_hangs_as_slack_ones_do(lower: float) -> None:
    nodes = NODES.copy()
    nodes[:, 1:3, 2] -= lower  # the edge, which then pulls with less than at its planned height
    nodes[:, :, 0] *= 0.8
    found = spans(nodes)
    chords = np.sum(found.chords, axis=-1)
    partly = np.zeros(3, dtype=np.bool_)
    for spare in np.linspace(0.02, 0.8, 40):
        cable = replace(law(0.12), lengths=chords + spare)
        T = cable.tensions(found)
        length = chords + np.sum(cable.arcs(found, T), axis=-1)
        real = cable.lengths + cable.compliance * (T - cable.reference)
        taut = ~cable.slack(T)
        np.testing.assert_allclose(length[taut], real[taut], rtol=1e-11)
        assert np.all(length[~taut] <= real[~taut] + 1e-11)
        # Slack in the sense of a span's own tension: the sag of a level span, w s²/(8 m).
        m = T[:, None] + 0.12 * (found.middles - cable.heights[:, None])
        deep = np.any(0.12 * found.chords**2 / 8.0 > 0.25 * found.chords * m, axis=-1)
        np.testing.assert_array_equal(cable.hanging(found, T), deep | ~taut)
        partly |= deep & taut
    assert partly.any() == (lower > 0.0)
