from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchopt.errors import InputError
from hitchopt.exports.reference_frame import AXES, ReferenceFrame
from hitchopt.trajectory import PiecewisePolynomial

FRAMES = st.builds(
    ReferenceFrame,
    st.sampled_from(sorted(AXES)),
    st.lists(st.floats(-50.0, 50.0), min_size=3, max_size=3),
    st.floats(-7.0, 7.0),
)


@given(FRAMES)
def test_there_and_back(frame: ReferenceFrame) -> None:
    rng = np.random.default_rng(0)
    part = PiecewisePolynomial(np.array([0.0, 1.0, 1.5]), rng.normal(size=(2, 4, 3, 5)))
    back = frame.in_plan(frame.placed(part))
    np.testing.assert_allclose(back.coefficients, part.coefficients, atol=1e-12)
    t = np.array([0.2, 1.4])
    np.testing.assert_allclose(frame.placed(part).at(t), frame.points(part.at(t)), atol=1e-12)
    np.testing.assert_allclose(
        frame.placed(part).at(t, 1), frame.vectors(part.at(t, 1)), atol=1e-11
    )


@pytest.mark.parametrize(
    ("name", "point", "heading"),
    [
        ("enu", [1.0, 2.0, 3.0], 0.0),
        ("nwu", [2.0, -1.0, 3.0], -0.5 * math.pi),
        ("ned", [2.0, 1.0, -3.0], 0.5 * math.pi),
    ],
)
def test_axes_by_hand(name: str, point: list[float], heading: float) -> None:
    frame = ReferenceFrame(name)
    assert frame.points(np.array([1.0, 2.0, 3.0])).tolist() == point
    assert frame.heading == pytest.approx(heading)


@pytest.mark.parametrize(
    ("arguments", "key"),
    [
        (("neu",), "frame"),
        (("enu", [1, 2]), "origin"),
        (("enu", [1, 2, math.nan]), "origin"),
        (("enu", [0, 0, 0], math.inf), "yaw"),
    ],
)
def test_nonsense_is_refused(arguments: tuple[object, ...], key: str) -> None:
    with pytest.raises(InputError, match=key):
        ReferenceFrame(*arguments)  # type: ignore[arg-type]
