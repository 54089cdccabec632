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
def test_rotations_keep_lengths_and_turn_correctly(frame: ReferenceFrame) -> None:
    np.testing.assert_allclose(frame.rotation @ frame.rotation.T, np.eye(3), atol=1e-14)
    # North-east-down is right-handed too; the swap of axes mends what the sign of z breaks.
    assert np.linalg.det(frame.rotation) == pytest.approx(1.0)


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


@given(FRAMES)
def test_the_heading_is_the_plan_s_x_axis(frame: ReferenceFrame) -> None:
    ahead = frame.vectors(np.array([1.0, 0.0, 0.0]))
    assert math.atan2(ahead[1], ahead[0]) == pytest.approx(frame.heading, abs=1e-12) or (
        abs(abs(frame.heading) - math.pi) < 1e-9  # two names of one direction
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


def test_between_files_as_their_formats_convert_them() -> None:
    """North-west-up to north-east-down is (x, -y, -z) and yaw to -yaw."""
    origin, yaw = [0.3, -2.0, 0.5], 0.7
    nwu, ned = ReferenceFrame("nwu", origin, yaw), ReferenceFrame("ned", origin, yaw)
    p = np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(ned.points(p), nwu.points(p) * [1.0, -1.0, -1.0], atol=1e-14)
    assert ned.heading == pytest.approx(-nwu.heading)


def test_turned_first_then_moved() -> None:
    frame = ReferenceFrame("enu", [10.0, 20.0, 1.0], math.pi / 2)
    np.testing.assert_allclose(frame.points(np.array([1.0, 0.0, 0.5])), [10.0, 21.0, 1.5])


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
