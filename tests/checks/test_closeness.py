"""Closest neighbours over time, against samples and the certificate."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from by_hand import ratios
from motions import random_curves, single
from refusals import assert_refused

from hitchopt.checks import certify
from hitchopt.checks.closeness import closeness
from hitchopt.hitch.requirements import Separation
from hitchopt.motion.motion import Motion
from hitchopt.values import Array


def swarm(n: int, seed: int) -> Motion:
    """Drones on curves that meet now and then; continuous or not is of no matter here."""
    return single(random_curves(n, seed), separation=Separation(0.1, 0.2))


def apart(motion: Motion, t: Array) -> Array:
    return ratios(motion.drones.at(t), motion.requirements.separation)


@pytest.mark.parametrize(("n", "spans"), [(2, 7), (9, 20), (30, 5)])
def test_no_sample_beats_a_span_or_a_pair_and_all_are_the_certificate(n: int, spans: int) -> None:
    motion = swarm(n, n)
    found = closeness(motion, spans)
    assert (len(found.spans), found.spans[0].start, found.spans[-1].end) == (spans, 0.0, 2.4)
    assert all(a.end == b.start for a, b in pairwise(found.spans))
    for span in found.spans:  # curves may jump at the joints
        least = np.min(apart(motion, np.linspace(span.start, span.end, 801)[1:-1]))
        assert span.bound <= least + 1e-9
        assert span.start <= span.time <= span.end
        assert span.bound <= span.value <= least + 1e-3
    names = motion.team.drone_names
    pairs = [(names[i], names[j]) for i, j in zip(*np.triu_indices(n, 1), strict=True)]
    sampled = dict(zip(pairs, np.min(apart(motion, np.linspace(0.0, 2.4, 5001)), 0), strict=True))
    for pair in found.pairs:
        assert sampled[pair.pair] - 5e-3 <= pair.bound <= sampled[pair.pair] + 1e-9
    bounds = [pair.bound for pair in found.pairs]
    assert bounds == sorted(bounds)
    worst = certify(motion)["separation"].worst
    for bound in (bounds[0], min(span.bound for span in found.spans)):
        assert bound == pytest.approx(worst, rel=2e-4, abs=1e-6)
    assert str(found).count("\n") == len(found.pairs)
    assert ", ".join(found.pairs[0].pair) in str(found)


def test_one_drone_has_no_neighbour() -> None:
    assert_refused(lambda: closeness(swarm(1, 0)), "drones", "neighbour")
    assert_refused(lambda: closeness(swarm(2, 0), 0), "spans", "at least 1")
