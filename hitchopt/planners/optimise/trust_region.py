"""One step of a refinement: a quadratic program around the current flight, solved in rounds.

Limits of motion have rows where they are nearly reached, and more where a solution breaks them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from hitchopt.hitch.quadratic_program import QuadraticProgram, solve_qp
from hitchopt.planners.candidates import Effort
from hitchopt.planners.optimise.cost import MOTION_JET, Expansion, convex_parts
from hitchopt.planners.optimise.flight import MARGIN, PENALTY, Flight, Step
from hitchopt.planners.optimise.knots import QuadraticTerms
from hitchopt.planners.optimise.motion_rows import ChosenRows, ClockSamples, LimitBlock
from hitchopt.planners.optimise.program import ENTRY_COST
from hitchopt.planners.optimise.shape_rows import ShapeBlock
from hitchopt.planners.optimise.splines import scattered
from hitchopt.values import Array, Indices

MAX_ROUNDS = 4  # Maximum number of programs of one step, with more rows each
RATE_CHANGE = 0.3  # Trust radius of x over its current value
NEAR = 0.8  # Share of a limit above which it has a row at first
BROKEN = 1.02  # Value over its limit above which a limit of motion gets a row
REACH_MARGIN = 5e-3  # [m] Distance beyond twice the stride up to which pairs have rows
NEAR_DISTANCE = 0.5  # Distance to its bound, in strides, below which a distance has a row at first

ADDED_DISTANCE = 0.1
"""Distance to its bound, in strides, below which a distance gets a row with others."""

BEND_WEIGHT = 1e-2  # [s/m²] Weight of second differences of the splines' coefficients
SLACK_UNIT = 0.01  # [m] Unit of slacks of distances, which scales the program
SLACK_PENALTY = 10.0  # Penalty of slacks over that of shortfalls of flights
REGULARISATION = 1e-9  # Added to the Hessian's diagonal


def best_step(flight: Flight, stride: float, effort: Effort) -> Step | None:
    """Return the solution of programs within a trust radius [m], or None without one."""
    limits = flight.limits
    samples = flight.samples
    chosen = ChosenRows.near(limits.ratios(flight.path, samples.rate), NEAR)
    limit_blocks = [limits.block(chosen)]
    shape = flight.shape_block(2.0 * stride + REACH_MARGIN, MARGIN)
    enforced = shape.smallest > -NEAR_DISTANCE * stride
    region = TrustRegion.of(flight, stride, shape)
    step: Step | None = None
    for _ in range(MAX_ROUNDS):
        program = region.program(limit_blocks, enforced)
        if not effort.spend(ENTRY_COST * float(program.P.nnz + program.A.nnz)):
            return None
        solution = solve_qp(program)
        if solution is None:
            return None
        step = region.step(solution)
        ratios = limits.ratios(flight.moved(step.splines), samples.moved_rate(step.rate))
        broken = ChosenRows.near(ratios, BROKEN).without(chosen)
        shortfall = shape.smallest - shape.rows @ step.splines
        is_short = shortfall > 0.0
        if not broken.any and not np.any(is_short & ~enforced):
            break
        enforced |= shortfall > -ADDED_DISTANCE * stride
        if broken.any:
            chosen = chosen.plus(broken)
            limit_blocks.append(limits.block(broken))
    return step


@dataclass(frozen=True, eq=False)
class TrustRegion:
    """The program of a step, without its rows: variables, objective and bounds.

    Variables are the changes of the splines' free coefficients over their trust radii, the changes
    of the coefficients of x, and slacks of distances that are too short.
    """

    flight: Flight  # The current flight
    shape: ShapeBlock  # All rows of shapes
    free: Indices  # (free,): coefficients of splines that change
    radii: Array  # (free,): their trust radii
    rate_gradient: Array  # (coefficients of x,) [s]: derivatives of duration and custom cost
    cost_gradient: Array  # (free,) [s]: derivatives of the custom cost by coefficients of splines
    hessian: sp.csc_array[np.float64]  # (variables, variables)

    @classmethod
    def of(cls, flight: Flight, stride: float, shape: ShapeBlock) -> TrustRegion:
        """Return the program around a flight within a trust radius [m].

        Radii decrease toward the ends of the path, as far as these are away in pieces: without
        that, coefficients next to the fixed ends bend the path more than they move it.
        """
        splines = flight.splines
        samples = flight.samples
        per_coefficient = stride * np.minimum(1.0, splines.from_ends)
        radii = np.outer(per_coefficient, splines.columns.is_free).ravel()
        free = np.flatnonzero(radii)
        unit_radii = sp.diags_array(radii[free])
        # Form of the squared second differences of all splines' coefficients
        differences = splines.pieces * np.diff(np.eye(splines.count), n=2, axis=0)
        bending = sp.csr_array(
            sp.kron(differences.T @ differences, sp.eye_array(splines.columns.size))
        )
        bends = bending[free][:, free] * (BEND_WEIGHT / flight.path.team.robots)
        # Duration ``Σ w / √x`` by the coefficients of x
        x = samples.rate[:, 0]
        basis = samples.rate_basis
        values = scattered(basis.indices, basis.jets[..., 0], samples.rate_count)
        rate_gradient = np.asarray(values.T @ (-0.5 * samples.weights * x**-1.5))
        of_rate = values.T @ sp.diags_array(0.75 * samples.weights * x**-2.5) @ values
        hessian = sp.block_diag([unit_radii @ bends @ unit_radii, sp.csr_array(of_rate)])
        cost_gradient = np.zeros(splines.width)
        if flight.cost_expansion is not None:
            cost = _custom_cost(samples, flight.cost_expansion, radii)
            cost_gradient = cost.gradient[: splines.width]
            rate_gradient = rate_gradient + cost.gradient[splines.width :]
            changing = np.append(free, splines.width + np.arange(samples.rate_count))
            hessian = hessian + cost.hessian[changing][:, changing]
        hessian = 0.5 * (hessian + hessian.T) + REGULARISATION * sp.eye_array(hessian.shape[0])
        violated = int(np.count_nonzero(shape.smallest > 0.0))
        slacks = sp.csr_array((violated, violated))
        whole = sp.csc_array(sp.block_diag([hessian, slacks]))
        return cls(flight, shape, free, radii[free], rate_gradient, cost_gradient[free], whole)

    def program(
        self, limit_blocks: Sequence[LimitBlock], enforced: NDArray[np.bool_]
    ) -> QuadraticProgram:
        """Return the program with rows of limits and enforced rows (rows,) of shapes."""
        width = self.flight.splines.width
        violated = np.flatnonzero(self.shape.smallest > 0.0)
        slacks = len(violated)
        entries = (np.full(slacks, SLACK_UNIT), (violated, np.arange(slacks)))
        slack_rows = sp.csr_array(entries, (len(self.shape.smallest), slacks))[enforced]
        limits = LimitBlock.stacked(limit_blocks)
        largest = limits.largest
        radii = sp.diags_array(self.radii)
        of_limits = [limits.rows[:, self.free] @ radii, limits.rows[:, width:], None]
        of_shapes = [self.shape.rows[enforced][:, self.free] @ radii, None, slack_rows]
        smallest = self.shape.smallest[enforced]
        free = np.ones(len(self.free))
        rate = RATE_CHANGE * self.flight.samples.rate_coefficients
        of_splines = self.radii * self.cost_gradient
        penalty = PENALTY * SLACK_UNIT * SLACK_PENALTY
        return QuadraticProgram(
            P=self.hessian,
            q=np.concatenate([of_splines, self.rate_gradient, np.full(slacks, penalty)]),
            A=sp.csc_array(sp.block_array([of_limits, of_shapes])),
            lower=np.append(np.full(len(largest), -np.inf), smallest),
            upper=np.append(largest, np.full(len(smallest), np.inf)),
            x_min=np.concatenate([-free, -rate, np.zeros(slacks)]),
            x_max=np.concatenate([free, rate, np.full(slacks, np.inf)]),
        )

    def step(self, solution: Array) -> Step:
        """Return the step of a solution (variables,)."""
        count = len(self.free)
        change = np.zeros(self.flight.splines.width)
        change[self.free] = self.radii * solution[:count]
        rate_change = solution[count : count + self.flight.samples.rate_count]
        of_cost = self.cost_gradient @ change[self.free]
        gain = -float(self.rate_gradient @ rate_change + of_cost)
        return Step(change, rate_change, gain)


def _custom_cost(samples: ClockSamples, expansion: Expansion, radii: Array) -> QuadraticTerms:
    """Return the custom cost by the coefficients of splines and of x.

    Its Hessian is in units of trust radii. Each sample's Hessian is convex in these units, by
    clipped eigenvalues.
    """
    splines = samples.splines
    size = splines.columns.size
    count = len(expansion.values)
    by_coefficients = np.einsum(
        "mco,uv->moucv", samples.basis.jets[:, :, :MOTION_JET], np.eye(size)
    ).reshape(count, MOTION_JET * size, -1)
    by_rate = samples.rate_basis.jets[:, :, :2].swapaxes(1, 2)
    local = by_coefficients.shape[2]
    # Derivatives of a sample's variables by its coefficients
    tangent = np.zeros((count, MOTION_JET * size + 2, local + by_rate.shape[2]))
    tangent[:, :-2, :local] = by_coefficients
    tangent[:, -2:, local:] = by_rate
    of_splines = splines.places(samples.basis, np.arange(size)).reshape(count, -1)
    of_rate = splines.width + samples.rate_basis.indices
    places = np.concatenate([of_splines, of_rate], axis=1)
    scale = np.append(radii, np.full(samples.rate_count, 1.0))[places]
    weights = samples.weights
    gradients = weights[:, None] * np.einsum("mv,mvl->ml", expansion.gradients, tangent)
    scaled = tangent * scale[:, None]
    hessians = convex_parts(scaled.swapaxes(1, 2) @ expansion.hessians @ scaled)
    hessians = weights[:, None, None] * hessians
    gradient = np.zeros(samples.width)
    np.add.at(gradient, places, gradients)
    rows, columns = np.broadcast_arrays(places[:, :, None], places[:, None])
    entries = (hessians.ravel(), (rows.ravel(), columns.ravel()))
    shape = (samples.width, samples.width)
    return QuadraticTerms(sp.csr_array(sp.coo_array(entries, shape)), gradient)
