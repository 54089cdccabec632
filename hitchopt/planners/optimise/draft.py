"""A nonlinear program as it is put together, in casadi's expressions."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Draft:
    """Variables, rows and costs as they are collected.

    Attributes
    ----------
    f: what is minimised, so far.
    """

    def __init__(self) -> None:
        self.f = ca.MX(0.0)
        self._x: list[ca.MX] = []
        self._boxes: list[tuple[Array, Array, Array]] = []
        self._g: list[ca.MX] = []
        self._ranges: list[tuple[Array, Array]] = []

    def variables(self, name: str, start: Array, lower: Array, upper: Array) -> ca.MX:
        """Return new variables, where they start and between which bounds they stay."""
        x = ca.MX.sym(name, len(start))
        self._x.append(x)
        self._boxes.append((start, lower, upper))
        return x

    def keep(self, value: ca.MX, least: Array | float, most: Array | float) -> None:
        """Keep values (a column) between their bounds."""
        shape = (value.numel(),)
        self._g.append(value)
        self._ranges.append((_full(least, shape), _full(most, shape)))

    def urge(self, value: ca.MX, least: Array, now: Array, dear: float) -> None:
        """Keep values (a column) above their bounds; what is below now may stay so, at a price.

        Parameters
        ----------
        value, least, now: (rows,), now where the variables start.
        dear: price of a unit by which a value stays below.
        """
        short = np.flatnonzero(now < least)
        if len(short):
            lack = (least - now)[short]
            zero, count = np.zeros(len(short)), len(short)
            slack = self.variables("slack", lack, zero, zero + np.inf)
            ones = (short.tolist(), list(range(count)), ca.DM.ones(count))
            spread = ca.DM.triplet(*ones, len(least), count)
            value = value + spread @ slack
            self.f += dear * ca.sum1(slack)
        self.keep(value, least, np.inf)

    @property
    def x(self) -> ca.MX:
        """All variables, a column."""
        return ca.vertcat(*self._x)

    @property
    def g(self) -> ca.MX:
        """All rows, a column."""
        return ca.vertcat(*self._g)

    def box(self) -> tuple[Array, Array, Array]:
        """Return where the variables start, and their bounds."""
        start, lower, upper = (np.concatenate(column) for column in zip(*self._boxes, strict=True))
        return start, lower, upper

    def ranges(self) -> tuple[Array, Array]:
        """Return the bounds of the rows."""
        least, most = (np.concatenate(column) for column in zip(*self._ranges, strict=True))
        return least, most


def _full(value: Array | float, shape: tuple[int]) -> Array:
    return np.broadcast_to(np.asarray(value, dtype=np.float64), shape)
