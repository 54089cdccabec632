"""What a clock leaves unbalanced of carried objects' inertia, at samples.

Newton's law at the samples of a clock, with derivatives of the plan's polynomials: shares of the
mass at clasps are solved for anew, and nothing of the bounds that certify stops is used.
"""

from __future__ import annotations

import numpy as np

from hitchopt.checks.clasps import LIMIT
from hitchopt.motion.motion import HoldBy, Motion
from hitchopt.objects import SolidObject
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.clock_phases import ClockPhases, advanced
from hitchopt.values import Array

RATE = 1e3
"""[Hz] At which clocks are sampled."""

MOVING = 1e-9
"""[m/s] Objects that are slower stand."""


def derivatives(part: PiecewisePolynomial, times: Array, count: int = 3) -> list[Array]:
    """Return the first derivatives (samples, *shape) at plan times, piece by piece."""
    piece = np.clip(np.searchsorted(part.breaks, times, side="right") - 1, 0, part.pieces - 1)
    x = np.clip((times - part.breaks[piece]) / part.durations[piece], 0.0, 1.0)
    found = [np.empty((len(times), *part.shape)) for _ in range(count)]
    for each in np.unique(piece).tolist():
        here = piece == each
        for order, values in enumerate(found, 1):
            c = part.differentiated(order).coefficients[each]
            weights = bernstein.basis(x[here], c.shape[-1] - 1)
            values[here] = (weights @ c.reshape(-1, c.shape[-1]).T).reshape(-1, *part.shape)
    return found


def unbalanced(motion: Motion, jets: Array) -> float:
    """Return the largest force that a clock adds, over the tension and over what is allowed of it.

    Parameters
    ----------
    motion: the plan; what it leaves unbalanced at its own rate is not counted.
    jets: (samples, 4) of the clock.
    """
    worst = 0.0
    for index, (name, body) in enumerate(motion.requirements.objects.items()):
        speeds = derivatives(motion.object_poses, jets[:, 0], 1)[0][:, index]
        on = jets[np.max(np.abs(speeds), axis=1) > MOVING]
        for phase in motion.phases:
            held = phase.hold is not None and phase.hold.object == name
            own = on[(on[:, 0] >= phase.start) & (on[:, 0] < phase.end)]
            if not held or not len(own):
                continue
            assert phase.hold is not None
            forces = _gripped if phase.hold.by is HoldBy.GRIP else _resting
            tension = np.min(motion.tensions.at(own[:, 0]), axis=1)
            found = np.linalg.norm(forces(motion, index, body, own), axis=-1) / tension[:, None]
            worst = max(worst, float(np.max(found)) / LIMIT)
    return worst


def _added(part: PiecewisePolynomial, jets: Array) -> Array:
    """Return by how much second derivatives by time differ from those at the plan's own rate."""
    first, second = derivatives(part, jets[:, 0], 2)
    s, a = (jets[:, k].reshape(-1, *(1,) * len(part.shape)) for k in (1, 2))
    found: Array = (s**2 - 1.0) * second + a * first
    return found


def _centre(poses: Array, body: SolidObject, share: float) -> Array:
    """Return centres of mass (samples, 3), given poses (samples, 5), or what is added to them."""
    x, y, z = body.centre_of_mass
    px, py, pz, c, s = poses.T
    return np.stack([px + c * x - s * y, py + s * x + c * y, pz + share * z], axis=-1)


def _gripped(motion: Motion, index: int, body: SolidObject, jets: Array) -> Array:
    """Return the force that the object as a whole lacks (samples, 1, 3) [N]."""
    added = _centre(_added(motion.object_poses, jets)[:, index], body, 0.0)
    return body.mass * added[:, None]


def _resting(motion: Motion, index: int, body: SolidObject, jets: Array) -> Array:
    """Return the force that every clasp lacks (samples, clasps, 3) [N]."""
    clasps = motion.team.layout.clasps
    places = motion.vertices.at(jets[:, 0])[:, clasps]
    centre = _centre(motion.object_poses.at(jets[:, 0])[:, index], body, 1.0)
    away = (places - centre[:, None])[..., :2]
    rows = np.concatenate([np.ones_like(away[..., :1]), away], axis=-1).swapaxes(1, 2)
    solved = np.linalg.pinv(rows)  # (samples, clasps, 3): of weight, and of where it acts
    added = _added(motion.vertices, jets)[:, clasps]
    pushed = _centre(_added(motion.object_poses, jets)[:, index], body, 0.0)
    assert body.rim is not None
    height = body.centre_of_mass[2] - body.rim.height
    loads = -body.mass * solved[..., :1] * added
    loads[..., 2] += body.mass * height * np.einsum("tkd,td->tk", solved[..., 1:], pushed[:, :2])
    return loads


def sampled(clock: ClockPhases) -> Array:
    """Return plan times and their derivatives (samples, 4) at RATE, and at the clock's end."""
    ends = np.cumsum(clock.duration)
    t = np.append(np.arange(0.0, ends[-1], 1.0 / RATE), ends[-1])
    phase = np.minimum(np.searchsorted(ends, t, side="right"), len(ends) - 1)
    return advanced(clock.jets[phase], t - (ends - clock.duration)[phase])
