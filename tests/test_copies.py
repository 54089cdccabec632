"""Copies of plans, by pickle or copy, are as read-only as plans, with the same certificate."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.values import Array
from hitchopt.values.fields import with_fields
from tests.helpers.plans import planned


def arrays_of(value: Any) -> Iterator[Array]:
    """Yield the arrays of a record, of its records and of its tuples."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, tuple | list | Mapping):
        entries = value.values() if isinstance(value, Mapping) else value
        for each in entries:
            yield from arrays_of(each)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        yield from arrays_of([getattr(value, each.name) for each in dataclasses.fields(value)])


@pytest.mark.parametrize("name", ["triangle", "swarms/circle_6"])
def test_copies_of_plans_are_read_only_and_have_the_same_certificate(name: str) -> None:
    plan = planned(name)
    reported = [check.name for check in plan.certificate.checks]
    for same in (copy.deepcopy(plan), pickle.loads(pickle.dumps(plan)), copy.copy(plan)):
        arrays = [*arrays_of(same.flight)]
        assert arrays
        assert not any(array.flags.writeable for array in arrays)
        assert repr(same) == repr(plan)
        assert same.certificate.limited == plan.certificate.limited
        assert [check.name for check in same.certificate.checks] == reported
        assert all(check.limit is not None for check in same.certificate.limited)
        assert ho.Plan(same.flight, same.certificate).duration == plan.duration


def test_a_plan_has_the_certificate_of_its_own_flight() -> None:
    one, other = planned("triangle"), planned("swarms/circle_6")
    limits = with_fields(one.motion.requirements.limits, speed=0.9)
    requirements = dataclasses.replace(one.motion.requirements, limits=limits)
    stricter = ho.Flight.of(one.motion.replaced(requirements=requirements))
    for flight in (other.flight, stricter, one.flight.prolonged(1.0)):
        with pytest.raises(ho.InputError, match="certificate = 'of another flight'"):
            ho.Plan(flight, one.certificate)
    with pytest.raises(ho.InputError, match="certificate = 'of another flight'"):
        ho.Plan(one.flight, ho.Certificate(one.duration, one.certificate.checks))
    assert ho.Plan(stricter, ho.certify(stricter)).duration == one.duration


def test_copies_of_what_changes_change_on() -> None:
    """A copy of a replanner replans as the original does."""
    plan = planned("triangle")
    steering = ho.Replanner(plan.motion.team, plan)
    to = plan.end.polygon.vertices[0] + 0.02
    for each in (copy.deepcopy(steering), steering):
        assert each.retarget(vertex=0, to=to, at=plan.duration).accepted
        assert each.plan.duration > plan.duration
