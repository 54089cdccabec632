"""Violations in words."""

from __future__ import annotations

import math
import sys

import pytest

from hitchopt.errors import broken_limit


@pytest.mark.parametrize("value", [-math.inf, -sys.float_info.max])
def test_what_contradicts_itself_is_infinitely_far_off(value: float) -> None:
    words = broken_limit("grip", value, 1.5, "min", "1", ("drum",))
    assert words == "grip: -inf is below the limit of 1.5 at drum"


def test_values_just_beyond_a_limit_differ_from_it_in_words() -> None:
    words = broken_limit("speed", 1.0 + 1e-11, 1.0, "max", "m/s", ())
    assert words == "speed: 1.00000000001 m/s is above the limit of 1 m/s"
