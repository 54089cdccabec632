"""Custom costs of flights, differentiated by casadi.

A cost is integrated over the flight's time. The search of routes estimates it at rest; refinement
of a route with its clock sees the hitch in motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.sparse as sp

from hitchopt.errors import InputError, RequestError
from hitchopt.hitch import Team
from hitchopt.hitch.casadi_model import CostFunction, model
from hitchopt.planners.optimise.knots import KnotPath, QuadraticTerms
from hitchopt.planners.optimise.parts import Columns
from hitchopt.planners.path import Path
from hitchopt.support import Feature, Neighbour, refused_value
from hitchopt.values import Array

if TYPE_CHECKING:
    import casadi as ca

OUTPUTS = (
    "positions",
    "velocities",
    "accelerations",
    "thrusts",
    "tilt_cosines",
    "legs",
    "exterior_angles",
    "separations",
)
"""Outputs of ``ho.model`` that a cost may use."""

RATES = ("vertex_velocities", "vertex_accelerations")
"""Inputs of ``ho.model`` that a cost may use, besides vertices, q-legs and tensions."""

MOTION_JET = 3  # Number of derivatives of flat outputs on which a cost depends, with the value
COST_SAMPLES = 65  # Number of samples of a path by which the integral of its cost is computed


class Expansion(NamedTuple):
    """Second-order expansions of a cost around J shapes (J, 4n)."""

    values: Array  # (J,) [s]
    gradients: Array  # (J, 4n), or by other variables
    hessians: Array  # (J, 4n, 4n)


@dataclass(frozen=True, eq=False)
class FlightCost:
    """The integral over time of a cost of a closed hitch in motion [1], in seconds.

    Raises InputError if the function cannot be evaluated on casadi's symbols, returns no scalar,
    has steps (``floor``, ``sign``, …), which have no useful derivative, or does not depend on
    the hitch.
    """

    team: Team  # The team of the hitch
    function: CostFunction  # Function of the model's outputs by name, and of s

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise self._refusal("specify one, or None")
        if not self.team.layout.closed:
            raise refused_value(Feature.COST, Neighbour.CHAINS, self.name, RequestError)
        _ = self._integrand

    @property
    def name(self) -> str:
        """Name of the function."""
        return str(getattr(self.function, "__name__", type(self.function).__name__))

    def _refusal(self, reason: str) -> InputError:
        bound = "a function of the model's outputs and s that casadi differentiates"
        return RequestError("cost", self.name, bound, reason)

    @cached_property
    def _integrand(self) -> ca.Function:
        """The function of the named outputs, in order, and s."""
        import casadi as ca

        robots = self.team.robots
        hitch = model(self.team, roll=True, tensions=True)
        sizes = {name: hitch.size1_out(name) for name in OUTPUTS}
        sizes |= dict.fromkeys(("vertices", *RATES), 3 * robots)
        sizes |= {"q_legs": robots, "tensions": robots}
        outputs = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
        s = ca.SX.sym("s")
        symbols = ca.vertcat(*outputs.values())
        try:
            value = ca.SX(self.function(outputs, s))
            gradient = ca.gradient(value, symbols) if value.is_scalar() else symbols
        except KeyError as error:
            raise self._refusal(f"{error} is not one of {', '.join(sizes)}") from error
        except Exception as error:
            reason = str(error).strip().splitlines() or [type(error).__name__]
            raise self._refusal(f"it raises {type(error).__name__}: {reason[-1]}") from error
        if value.shape != (1, 1):
            raise self._refusal(f"return one number, not {value.shape[0]} x {value.shape[1]}")
        if not ca.depends_on(value, symbols):
            raise self._refusal("it does not depend on the hitch")
        function = ca.Function("cost", [symbols, s], [value])
        step_functions = _step_functions(function)
        if step_functions:
            raise self._refusal(f"{step_functions[0]} has no useful derivative")
        if gradient.is_zero():
            raise self._refusal("its derivative is zero for all shapes")
        return function

    @cached_property
    def _level_expansion(self) -> ca.Function:
        """The expansion of hitches without roll."""
        return self._expansion(rolled=False)

    @cached_property
    def _rolled_expansion(self) -> ca.Function:
        """The expansion of hitches with roll."""
        return self._expansion(rolled=True)

    def _expansion(self, *, rolled: bool) -> ca.Function:
        """Return the function of a shape to its cost, and the cost's gradient and Hessian.

        Its inputs are ``shape``, plan view of vertices (2n), q-legs (n) and tensions (n), in the
        order of a table's columns, and ``height`` (n), ``roll`` (n) and ``s``.
        """
        import casadi as ca

        n = self.team.robots
        shape = ca.SX.sym("shape", 4 * n)
        height = ca.SX.sym("height", n)
        roll = ca.SX.sym("roll", n)
        s = ca.SX.sym("s")
        plan_view, q_legs, tensions = ca.vertsplit(shape, [0, 2 * n, 3 * n, 4 * n])
        vertices = ca.vec(ca.vertcat(ca.reshape(plan_view, 2, n), height.T))
        inputs = {"vertices": vertices, "q_legs": q_legs, "tensions": tensions}
        if rolled:
            inputs["roll"] = roll
        results = model(self.team, roll=rolled, tensions=True)(**inputs)
        at_rest = [ca.SX(3 * n, 1) for _ in RATES]
        value = self._integrand(
            ca.vertcat(*(results[name] for name in OUTPUTS), vertices, *at_rest, q_legs, tensions),
            s,
        )
        hessian, gradient = ca.hessian(value, shape)
        return ca.Function(
            "expansion",
            [shape, height, roll, s],
            [value, gradient, ca.densify(hessian)],
            ["shape", "height", "roll", "s"],
            ["value", "gradient", "hessian"],
            {"cse": True},
        )

    def expand(self, shapes: Array, heights: Array, roll: Array | None, s: Array) -> Expansion:
        """Return the cost of shapes (J, 4n) at s (J,), and its derivatives by them.

        Parameters
        ----------
        heights: (J, n) [m], of vertices.
        roll: (J, n) [rad], or None.
        """
        function = self._level_expansion if roll is None else self._rolled_expansion
        angles = np.zeros((len(s), self.team.robots)) if roll is None else roll
        results = function.map(len(s))(shape=shapes.T, height=heights.T, roll=angles.T, s=s[None])
        values = np.asarray(results["value"])
        gradients = np.asarray(results["gradient"])
        hessians = np.asarray(results["hessian"])
        if not all(np.all(np.isfinite(part)) for part in (values, gradients, hessians)):
            raise self._refusal("its value or derivative is not finite on the route")
        size = shapes.shape[1]
        return Expansion(values[0], gradients.T, hessians.T.reshape(len(s), size, size))

    def at_rest(self, path: Path, duration: float) -> float:
        """Return the integral of the cost [s] as if s were the share of a duration [s], at rest."""
        s = np.linspace(0.0, 1.0, COST_SAMPLES)
        flat = path.flat(s, 1)
        places = flat.vertices[..., 0]
        plan_view = places[..., :2].reshape(len(s), -1)
        shapes = np.concatenate([plan_view, flat.q_legs[..., 0], flat.tensions[..., 0]], axis=1)
        roll = None if flat.roll is None else flat.roll[..., 0]
        values = self.expand(shapes, places[..., 2], roll, s).values
        return duration * float(np.sum(values[1:] + values[:-1]) / (2.0 * (len(s) - 1)))

    def terms(self, path: KnotPath, duration: float) -> QuadraticTerms:
        """Return the expansion of ``at_rest`` around a path, convex by clipped eigenvalues."""
        columns = path.columns
        inner = path.table[1:-1]
        steps = path.steps
        shape_columns = np.concatenate([columns.vertices.ravel(), columns.q_legs, columns.tensions])
        roll = None if path.roll is None else path.roll[1:-1]
        heights = np.full((len(inner), self.team.robots), path.altitude)
        s = np.arange(1, steps) / steps
        expansion = self.expand(inner[:, shape_columns], heights, roll, s)
        gradient = np.zeros(inner.shape)
        step = duration / steps
        gradient[:, shape_columns] = step * expansion.gradients
        convex = convex_parts(expansion.hessians)
        entries = columns.flat_index(np.arange(len(inner))[:, None], shape_columns)
        row = np.broadcast_to(entries[..., None], convex.shape)
        column = np.broadcast_to(entries[:, None], convex.shape)
        indices = (row.ravel(), column.ravel())
        weighted = (step * convex).ravel()
        hessian = sp.csr_array(sp.coo_array((weighted, indices), (inner.size, inner.size)))
        return QuadraticTerms(hessian, gradient.ravel())

    @cached_property
    def _flight_functions(self) -> dict[tuple[bool, bool], ca.Function]:
        """The functions of ``_flight_expansion`` that are built."""
        return {}

    def _flight_expansion(self, *, rolled: bool, varying: bool) -> ca.Function:
        """Return the function of a hitch in motion to its cost over time, and its derivatives.

        Inputs are ``unknowns`` (size, 3) by a first clock τ, in the order of ``Columns``,
        ``heights`` (n, 3), ``tensions`` (n), which are not used if they vary, ``clock`` (2, 1), the
        squared rate x and its first derivative, and ``s``. The value is the cost over √x.
        """
        import casadi as ca

        n = self.team.robots
        sizes = {"points": 2 * n, "q_legs": n, "roll": n if rolled else 0}
        sizes["tensions"] = n if varying else 0
        unknowns = ca.SX.sym("unknowns", sum(sizes.values()), MOTION_JET)
        heights = ca.SX.sym("heights", n, MOTION_JET)
        tensions = ca.SX.sym("tensions", n)
        clock = ca.SX.sym("clock", 2)
        s = ca.SX.sym("s")

        def by_time(jet: ca.SX) -> ca.SX:
            """Return derivatives by t from those by τ."""
            first, second = jet[:, 1], jet[:, 2]
            acceleration = clock[0] * second + 0.5 * clock[1] * first
            return ca.horzcat(jet[:, 0], ca.sqrt(clock[0]) * first, acceleration)

        ends = np.append(0, np.cumsum(list(sizes.values()))).tolist()
        parts = ca.vertsplit(by_time(unknowns), ends)
        points, q_legs, roll, varied = parts
        rise = by_time(heights)
        inputs: dict[str, ca.SX] = {}
        for order, ending in enumerate(("", "_velocities", "_accelerations")):
            place = ca.reshape(points[:, order], 2, n)
            of_order = {
                "vertices" if not order else f"vertex{ending}": ca.vec(
                    ca.vertcat(place, rise[:, order].T)
                ),
                f"q_leg{ending or 's'}": q_legs[:, order],
            }
            if rolled:
                of_order[f"roll{ending}"] = roll[:, order]
            if varying:
                of_order[f"tension{ending or 's'}"] = varied[:, order]
            inputs |= of_order
        inputs.setdefault("tensions", tensions)
        results = model(self.team, roll=rolled, tensions=True)(**inputs)
        values = [results[name] for name in OUTPUTS]
        values += [inputs[name] for name in ("vertices", *RATES, "q_legs", "tensions")]
        value = self._integrand(ca.vertcat(*values), s) / ca.sqrt(clock[0])
        variables = ca.vertcat(ca.vec(unknowns), clock)
        hessian, gradient = ca.hessian(value, variables)
        return ca.Function(
            "flight_cost",
            [unknowns, heights, tensions, clock, s],
            [value, gradient, ca.densify(hessian)],
            ["unknowns", "heights", "tensions", "clock", "s"],
            ["value", "gradient", "hessian"],
            {"cse": True},
        )

    def expand_flight(
        self, unknowns: Array, heights: Array, clock: Array, s: Array, columns: Columns
    ) -> Expansion:
        """Return the cost over √x at M samples of a flight, and its derivatives.

        Derivatives are by the unknowns' first three derivatives, one after another, then by x and
        its first derivative.

        Parameters
        ----------
        unknowns: (M, 3, unknowns), derivatives by τ.
        heights: (M, 3, n) [m], derivatives by τ.
        clock: (M, 2): x and its first derivative.
        s: (M,)
        columns: what the unknowns are.
        """
        key = columns.rolled, columns.varying
        if key not in self._flight_functions:
            rolled, varying = key
            self._flight_functions[key] = self._flight_expansion(rolled=rolled, varying=varying)
        function = self._flight_functions[key]
        results = function.map(len(s))(
            unknowns=unknowns.reshape(-1, unknowns.shape[-1]).T,
            heights=heights.reshape(-1, heights.shape[-1]).T,
            tensions=self.team.tension,
            clock=clock.T,
            s=s[None],
        )
        values = np.asarray(results["value"])
        gradients = np.asarray(results["gradient"])
        hessians = np.asarray(results["hessian"])
        if not all(np.all(np.isfinite(part)) for part in (values, gradients, hessians)):
            raise self._refusal("its value or derivative is not finite on the route")
        size = len(gradients)
        return Expansion(values[0], gradients.T, hessians.T.reshape(len(s), size, size))


def _step_functions(function: ca.Function) -> list[str]:
    """Return the names of step functions that a function uses; it has no derivative at steps."""
    import casadi as ca

    names = {ca.OP_FLOOR: "floor", ca.OP_CEIL: "ceil", ca.OP_SIGN: "sign", ca.OP_FMOD: "fmod"}
    used = {function.instruction_id(k) for k in range(function.n_instructions())}
    return [names[operation] for operation in sorted(used & names.keys())]


def convex_parts(hessians: Array) -> Array:
    """Return symmetric matrices (J, m, m) with negative eigenvalues replaced by zero."""
    eigenvalues, eigenvectors = np.linalg.eigh(hessians)
    clipped = np.maximum(eigenvalues, 0.0)[:, None]
    convex: Array = (eigenvectors * clipped) @ eigenvectors.swapaxes(1, 2)
    return convex
