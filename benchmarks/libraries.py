"""What each library does: calls of casadi, toppra, ruckig and OSQP while problems are planned.

Usage: python -m benchmarks libraries

Calls are counted at the public interfaces that hitchopt uses; casadi's functions by their names,
of which those with numbers count, not those that build other functions. ``derivatives``, ``limit``
and ``shape`` are evaluated for many clasps at once; ``program`` is a quadratic one, by PIQP.
"""

from __future__ import annotations

import functools
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest import mock

import casadi as ca
import osqp
import ruckig
import toppra.algorithm

import hitchopt as ho
from benchmarks.measuring import ROOT
from problems.random_morph import irregular_pairs

COLUMNS = ("morph", "optimized", "form", "swarm")
"""Problems whose calls are counted."""

ROUTED_PAIR = 2
"""Pair of irregular polygons whose straight path is infeasible."""


def problems() -> dict[str, Callable[[], object]]:
    """Return what plans each problem."""
    pair = irregular_pairs()[ROUTED_PAIR]
    team = ho.Team(pair["n"], pair["cable_length"])
    start = ho.Hitch.spread(team, pair["start"], pair["altitude"])
    form = ROOT / "problems" / "form_triangle.yaml"
    swarm = ROOT / "problems" / "swarms" / "random.yaml"
    plans: list[Callable[[], object]] = [
        lambda: ho.morph(start, pair["goal"]),
        lambda: ho.morph(start, pair["goal"], optimize=True),
        lambda: ho.solve(form),
        lambda: ho.solve(swarm),
    ]
    return dict(zip(COLUMNS, plans, strict=True))


def has_symbols(arguments: Sequence[Any]) -> bool:
    """Return whether a call of a function builds another one."""
    return any(isinstance(each, ca.SX | ca.MX) for each in arguments)


def name_of(function: ca.Function) -> str:
    """Return the name of a function, also if it is mapped."""
    return f"casadi `{re.sub('^map[0-9]+_', '', function.name())}`"


@contextmanager
def counted_calls() -> Iterator[Counter[str]]:
    """Count calls of the libraries by name while the context lasts."""
    calls = Counter[str]()
    call = ca.Function.__call__
    buffer = ca.Function.buffer

    def function(self: ca.Function, *arguments: Any, **named: Any) -> Any:
        """Count a call of a function; quadratic programs are functions, too."""
        if not has_symbols([*arguments, *named.values()]):
            calls[name_of(self)] += 1
        return call(self, *arguments, **named)

    def buffered(self: ca.Function) -> tuple[Any, Callable[[], None]]:
        """Count evaluations of a function that reads and writes arrays."""
        buffers, run = buffer(self)

        def counted() -> None:
            calls[name_of(self)] += 1
            run()

        return buffers, counted

    def counter(name: str, original: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that counts its calls."""

        @functools.wraps(original)
        def counted(*arguments: Any, **named: Any) -> Any:
            calls[name] += 1
            return original(*arguments, **named)

        return counted

    profile = toppra.algorithm.TOPPRA
    others = (
        (profile, "compute_parameterization", "toppra `TOPPRA`"),
        (ruckig.Ruckig, "calculate", "ruckig `Ruckig`"),
        (osqp.OSQP, "solve", "OSQP `solve`"),
    )
    with ExitStack() as stack:
        stack.enter_context(mock.patch.object(ca.Function, "__call__", function))
        stack.enter_context(mock.patch.object(ca.Function, "buffer", buffered))
        for owner, method, name in others:
            counting = counter(name, getattr(owner, method))
            stack.enter_context(mock.patch.object(owner, method, counting))
        yield calls


def counts() -> dict[str, Counter[str]]:
    """Return the calls of each problem."""
    by_problem = {}
    for name, plan in problems().items():
        with counted_calls() as calls:
            plan()
        by_problem[name] = calls
    return by_problem


def lines(by_problem: dict[str, Counter[str]]) -> Iterator[str]:
    """Yield a line for each problem, with its calls by name."""
    for problem, calls in by_problem.items():
        words = ", ".join(f"{name} {calls[name]:,}" for name in sorted(calls))
        yield f"- {problem}: {words}"


def main() -> None:
    """Print the calls."""
    for line in lines(counts()):
        print(line)
