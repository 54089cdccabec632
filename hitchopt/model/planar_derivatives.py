"""Derivatives of a robot's drones at rest, seen from above, by what they follow from."""

from __future__ import annotations

import casadi as ca

from hitchopt.model.cache import stored
from hitchopt.model.loaded_clasp import loaded_planar_function
from hitchopt.model.robot import planar_function

VARIED = 3
"""Number of leading inputs by which is differentiated: vertices, legs, tensions."""


def planar(loaded: bool, choice: bool) -> ca.Function:
    """Return ``loaded_planar_function`` or ``planar_function``, for its own choice."""
    return loaded_planar_function(choice) if loaded else planar_function(choice)


@stored
def planar_slopes(loaded: bool, choice: bool) -> ca.Function:
    """Return the first derivatives of ``planar``.

    Returns
    -------
    Function with the inputs of ``planar`` and an output ``slopes`` (6, width), sparse: of place
    and turn in a column, by vertices, legs and tensions in a column.
    """
    given, varied, rows = _rows_of(planar(loaded, choice))
    slopes = ca.jacobian(rows, varied)
    names = planar(loaded, choice).name_in()
    return ca.Function("slopes", given, [slopes], names, ["slopes"], {"cse": True})


@stored
def planar_bends(loaded: bool, choice: bool) -> ca.Function:
    """Return the second derivatives of ``planar``.

    Returns
    -------
    Function with the inputs of ``planar`` and ``multipliers`` (6, 1), and an output ``bends``
    (width, width), sparse: the upper triangle of the Hessian of the rows' weighted sum.
    """
    given, varied, rows = _rows_of(planar(loaded, choice))
    multipliers = ca.SX.sym("multipliers", rows.numel())
    bends = ca.triu(ca.hessian(ca.dot(multipliers, rows), varied)[0])
    names = [*planar(loaded, choice).name_in(), "multipliers"]
    return ca.Function("bends", [*given, multipliers], [bends], names, ["bends"], {"cse": True})


def _rows_of(function: ca.Function) -> tuple[list[ca.SX], ca.SX, ca.SX]:
    """Return a function's inputs, those that are varied in a column, and its outputs in one."""
    sizes = [function.size1_in(i) for i in range(function.n_in())]
    given = [ca.SX.sym(name, size) for name, size in zip(function.name_in(), sizes, strict=True)]
    return given, ca.vertcat(*given[:VARIED]), ca.vertcat(*function.call(given))
