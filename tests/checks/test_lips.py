"""Cables that hold an object from below its lip: no sampled point of one is inside the lip."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.motion.motion import Motion
from hitchopt.values import Array
from tests.helpers.groups import part
from tests.helpers.motions import row
from tests.helpers.plans import planned

POT = "pot"
ENTRY = 1e-3  # [m] Depth of entry below which samples and bounds need not agree


@cache
def held() -> Motion:
    """The part of the plan on which two cables are tied around a pot, carry it and are untied."""
    return part(planned("two_robots_lip").motion, "straddle", "unstraddle")


@cache
def seen_from_the_pot(count: int = 40_001) -> Array:
    """Points (times, parts, 2, 3) of the pot's frame between which cables are straight."""
    motion = held()
    first, last = motion.drones.breaks[[0, -1]]
    times = np.linspace(first, last, count)
    pose = motion.poses.at(times)[:, 0]
    place, (c, s) = pose[:, :3], pose[:, 3:].T
    turned = np.stack([np.stack([c, s], -1), np.stack([-s, c], -1)], -2)

    def in_frame(points: Array) -> Array:
        offsets = points - place.reshape(-1, *[1] * (points.ndim - 2), 3)
        level = np.einsum("tij,t...j->t...i", turned, offsets[..., :2])
        return np.concatenate([level, offsets[..., 2:]], axis=-1)

    inner = in_frame(motion.anchors.at(times))  # vertices, once the hitch is tied
    drones, contacts = in_frame(motion.drones.at(times)), in_frame(motion.contacts.at(times))
    drones = drones.reshape(inner.shape)
    ends = np.stack([drones, inner], axis=3), np.stack([inner, contacts], axis=3)
    return np.concatenate([each.reshape(count, -1, 2, 3) for each in ends], axis=1)


def with_lip(radius: float, height: float) -> Motion:
    """Return the motion with another lip of the pot."""
    motion = held()
    pot = motion.requirements.objects[POT]
    changed = replace(pot, rim=ho.Rim(ho.Section(radius=radius), height))
    requirements = replace(motion.requirements, objects={POT: changed})
    return motion.replaced(requirements=requirements)


@pytest.mark.parametrize("seed", range(12))
def test_cables_cut_a_lip_exactly_where_samples_do(seed: int) -> None:
    """Lips are discs: a cable is inside one where it crosses its plane within its circle."""
    rng = np.random.default_rng(seed)
    radius, height = rng.uniform(0.125, 0.35), rng.uniform(0.2, 0.4)
    first, last = np.moveaxis(seen_from_the_pot(), 2, 0)
    below, above = first[..., 2] - height, last[..., 2] - height
    share = np.clip(below / np.where(below == above, 1.0, below - above), 0.0, 1.0)
    crossing = first + share[..., None] * (last - first)
    crossed = below * above < 0.0
    beyond = np.linalg.norm(crossing[..., :2], axis=-1) - radius
    gap = float(np.min(beyond, initial=np.inf, where=crossed))
    check = row(with_lip(radius, height), "object_clearance")
    if gap < -ENTRY:
        assert (check.worst, check.where[-1]) == (0.0, POT)
    elif gap > ENTRY:
        assert check.worst > 0.0
