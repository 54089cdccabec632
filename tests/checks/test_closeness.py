"""Closest neighbours over time, against samples and the certificate."""

from __future__ import annotations

import numpy as np
import pytest
from free_cases import random_curves, single

from hitchopt.checks import certify
from hitchopt.checks.closeness import closeness
from hitchopt.errors import InputError
from hitchopt.hitch.requirements import Separation
from hitchopt.motion.motion import Motion


def swarm(n: int, seed: int) -> Motion:
    """Drones on curves that meet now and then; continuous or not is of no matter here."""
    return single(random_curves(n, seed), separation=Separation(0.1, 0.2))


@pytest.mark.parametrize(("n", "spans"), [(2, 7), (9, 20), (30, 5)])
def test_no_sample_beats_a_span_and_all_spans_are_the_certificate(n: int, spans: int) -> None:
    motion = swarm(n, n)
    found = closeness(motion, spans)
    assert found.spans[0].start == 0.0
    assert found.spans[-1].end == 2.4
    i, j = np.triu_indices(n, 1)
    names = motion.team.drone_names
    for before, span in zip((None, *found.spans[:-1]), found.spans, strict=True):
        assert before is None or before.end == span.start
        inside = np.linspace(span.start, span.end, 801)[1:-1]  # curves may jump at the joints
        points = motion.drones.at(inside) * motion.requirements.separation.scale
        ratio = np.linalg.norm(points[:, i] - points[:, j], axis=-1)
        assert span.bound <= np.min(ratio) + 1e-9
        assert span.start <= span.time <= span.end
        assert span.bound <= span.value <= np.min(ratio) + 1e-3
        assert span.pair[0] in names
        assert span.pair[1] in names
    worst = certify(motion)["separation"].worst
    assert min(span.bound for span in found.spans) == pytest.approx(worst, rel=2e-4, abs=1e-6)
    assert found.pairs[0].bound == pytest.approx(worst, rel=2e-4, abs=1e-6)


def test_pairs_are_followed_over_the_whole_plan() -> None:
    motion = swarm(12, 3)
    found = closeness(motion, 24)
    index = {name: k for k, name in enumerate(motion.team.drone_names)}
    t = np.linspace(0.0, 2.4, 5001)
    points = motion.drones.at(t)
    for pair in found.pairs:
        offset = points[:, index[pair.pair[0]]] - points[:, index[pair.pair[1]]]
        ratio = np.linalg.norm(offset * motion.requirements.separation.scale, axis=-1)
        assert pair.bound <= np.min(ratio) + 1e-9
        assert pair.bound >= np.min(ratio) - 5e-3
    assert [p.bound for p in found.pairs] == sorted(p.bound for p in found.pairs)
    assert str(found).count("\n") == len(found.pairs)
    assert ", ".join(found.pairs[0].pair) in str(found)


def test_one_drone_has_no_neighbour() -> None:
    with pytest.raises(InputError, match="neighbour"):
        closeness(swarm(1, 0))
    with pytest.raises(InputError, match="spans"):
        closeness(swarm(2, 0), 0)
