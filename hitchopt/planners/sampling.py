"""Functions of a path's parameter, or knots, as quintic splines: the parts of custom paths."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hitchopt.errors import InputError
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.splines import evenly_interpolated, interpolated
from hitchopt.values import Array, Points, as_array

FunctionOrKnots = Points | Callable[[float], Points]
"""Values over s: a function of s from 0 to 1, or knots (J, …) at evenly spaced s."""

FUNCTION_SAMPLES = (65, 129, 257, 513)
"""Numbers of samples of a function of s, tried until the spline fits between them."""

FIT_TOLERANCE = 1e-4  # Largest difference of a spline from its function between samples [m or rad]

FIT_TESTS = 2048
"""Number of s at which a fit is tested, multiples of the golden ratio modulo 1. No periodic
function vanishes at all of them, and they are at most 0.001 apart."""

GOLDEN_RATIO = 0.5 * (1.0 + math.sqrt(5.0))

MIN_KNOTS = 3  # Smallest number of knots of a natural quintic spline

SMOOTH_AT_REST = "smooth, with zero velocity and acceleration at both ends"


@dataclass(frozen=True, eq=False)
class EvenSamples:
    """Values at evenly spaced s from 0 to 1."""

    values: Array  # (J, *shape)
    smooth: bool  # True if the values are samples of a function, not knots
    at_rest: bool  # True if the first two derivatives vanish at both ends

    @property
    def spline(self) -> PiecewisePolynomial:
        """The quintic spline through the values."""
        if self.smooth and not self.at_rest:
            return evenly_interpolated(self.values)
        s = np.linspace(0.0, 1.0, len(self.values))
        return interpolated(s, self.values, zero_orders=(1, 2) if self.at_rest else (3, 4))


ValueShape = tuple[int, ...]  # Shape of the value of a function of s, or of a knot


def sampled(
    key: str, given: FunctionOrKnots, shapes: tuple[ValueShape, ...], *, at_rest: bool
) -> EvenSamples:
    """Return samples of a function of s, or knots, whose values have one of the shapes."""
    if callable(given):
        return _fitted(key, given, shapes, at_rest=at_rest)
    values = as_array(key, given)
    if values.shape[1:] not in shapes or len(values) < MIN_KNOTS:
        bound = f"a function of s, or {MIN_KNOTS} or more knots of shape {_words(shapes)}"
        remedy = "specify a knot for each of evenly spaced s from 0 to 1"
        raise InputError(key, given, bound, remedy)
    return EvenSamples(_finite(key, values), smooth=False, at_rest=at_rest)


def _fitted(
    key: str,
    function: Callable[[float], Points],
    shapes: tuple[ValueShape, ...],
    *,
    at_rest: bool,
) -> EvenSamples:
    """Return as many samples of a function of s as its spline needs to fit between them."""
    tested = np.sort(np.arange(1, FIT_TESTS + 1) * GOLDEN_RATIO % 1.0)
    expected = _values(key, function, shapes, tested)
    for count in FUNCTION_SAMPLES:
        s = np.linspace(0.0, 1.0, count)
        values = _values(key, function, shapes, s)
        samples = EvenSamples(values, smooth=True, at_rest=at_rest)
        differences = np.abs(samples.spline.at(tested) - expected)
        misfits = np.max(differences.reshape(len(tested), -1), axis=1)
        if np.max(misfits) <= FIT_TOLERANCE:
            return samples
    worst = int(np.argmax(misfits))
    misfit = f"off by {misfits[worst]:.2g} between {count} samples near s = {tested[worst]:.3g}"
    bound = f"{SMOOTH_AT_REST if at_rest else 'smooth'}, within {FIT_TOLERANCE:g} of its spline"
    raise InputError(key, misfit, bound, "make it smoother or split the path")


def _values(
    key: str, function: Callable[[float], Points], shapes: tuple[ValueShape, ...], s: Array
) -> Array:
    """Return the finite values (J, *shape) of a function at s (J,)."""
    bound = f"a function of s to shape {_words(shapes)}"
    try:
        values = [as_array(key, function(parameter)) for parameter in s.tolist()]
    except (TypeError, ValueError) as error:
        raise InputError(key, function, bound, f"it raises {error}") from error
    value_shapes = [value.shape for value in values]
    wrong_shape = next((shape for shape in value_shapes if shape not in shapes), None)
    if wrong_shape is None and len(set(value_shapes)) > 1:
        wrong_shape = value_shapes[0]
    if wrong_shape is not None:
        remedy = "return a row per point or robot, as numbers"
        raise InputError(key, f"shape {wrong_shape}", bound, remedy)
    return _finite(key, np.stack(values))


def _words(shapes: tuple[ValueShape, ...]) -> str:
    """Return shapes in words, such as ``(3, 2) or (3, 3)``."""
    return " or ".join(map(str, shapes))


def _finite(key: str, values: Array) -> Array:
    """Return values, or raise InputError if they are not finite."""
    if not np.all(np.isfinite(values)):
        raise InputError(key, "nan or infinite", "finite for s from 0 to 1", "check its formula")
    return values
