"""A nonlinear program as it is put together, in casadi's expressions."""

from __future__ import annotations

import casadi as ca
import numpy as np

from hitchopt.values import Array


class Draft:
    """Variables, rows and costs as they are collected.

    Attributes
    ----------
    f: sum of the costs so far.
    """

    def __init__(self) -> None:
        self.f = ca.MX(0.0)
        self._variables: list[tuple[ca.MX, Array, Array, Array]] = []
        self._rows: list[tuple[ca.MX, Array, Array]] = []

    def variables(self, name: str, start: Array, lower: Array, upper: Array) -> ca.MX:
        """Return new variables that start at ``start`` and stay within their bounds."""
        x = ca.MX.sym(name, len(start))
        self._variables.append((x, start, lower, upper))
        return x

    def bound(self, value: ca.MX, least: Array | float, most: Array | float) -> None:
        """Add rows that keep values (a column) between their bounds."""
        lower, upper = (np.zeros(value.numel()) + end for end in (least, most))
        self._rows.append((value, lower, upper))

    def soft_bound(self, value: ca.MX, least: Array, now: Array, weight: float) -> None:
        """Add rows that keep values (a column) above their bounds, softly where they are not now.

        Parameters
        ----------
        value, least, now: (rows,), now where the variables start.
        weight: penalty weight of a unit by which a value stays below.
        """
        short = np.flatnonzero(now < least)
        if len(short):
            lack = (least - now)[short]
            count = len(short)
            slack = self.variables("slack", lack, np.zeros(count), np.full(count, np.inf))
            ones = (short.tolist(), list(range(count)), ca.DM.ones(count))
            value = value + ca.DM.triplet(*ones, len(least), count) @ slack
            self.f += weight * ca.sum1(slack)
        self.bound(value, least, np.inf)

    def program(self) -> tuple[dict[str, ca.MX], dict[str, Array]]:
        """Return casadi's expressions x, f, g, and its numbers x0, lbx, ubx, lbg, ubg."""
        x, *box = zip(*self._variables, strict=True)
        g, *ranges = zip(*self._rows, strict=True)
        numbers = [np.concatenate(column) for column in (*box, *ranges)]
        expressions = {"x": ca.vertcat(*x), "f": self.f, "g": ca.vertcat(*g)}
        names = ("x0", "lbx", "ubx", "lbg", "ubg")
        return expressions, dict(zip(names, numbers, strict=True))
