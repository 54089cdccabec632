"""A rival: rockit-meco, multiple shooting of the flat outputs' integrators, free final time.

Vertices and q-legs are states with velocity and acceleration; their jerk is the control, constant
between knots. The same limits at the knots as ``plain_opti``, from the same straight line.
"""

from __future__ import annotations

from importlib import import_module

import numpy as np
from numpy.typing import NDArray

from benchmarks.plain_opti import keep_limits
from benchmarks.rival import RivalError, Solution, flat_ends, flat_sampler, straight_time
from benchmarks.tasks import Task

Array = NDArray[np.float64]

INTERVALS = 24


def solve_rockit(task: Task, seconds: float) -> Solution:
    """Return rockit's solution, found in at most that many seconds of IPOPT.

    Raises
    ------
    RivalError: IPOPT gives up, or runs out of time.
    """
    rockit = import_module("rockit")
    first, last = flat_ends(task)
    guess = straight_time(task)
    ocp = rockit.Ocp(T=rockit.FreeTime(guess))
    states = [ocp.state(len(first)) for _ in range(3)]
    jerk = ocp.control(len(first))
    for state, rate in zip(states, [*states[1:], jerk], strict=True):
        ocp.set_der(state, rate)
    for at, place in ((ocp.at_t0, first), (ocp.at_tf, last)):
        for state, value in zip(states, (place, 0.0, 0.0), strict=True):
            ocp.subject_to(at(state) == value)
    keep_limits(ocp, task, [value.T for value in (*states, jerk)])
    ocp.subject_to(ocp.T >= 0.1)
    ocp.add_objective(ocp.T)
    ocp.set_initial(states[0], first + (last - first) * ocp.t / guess)
    options = {"print_level": 0, "sb": "yes", "max_iter": 1000, "max_cpu_time": seconds}
    ocp.solver("ipopt", {"expand": True, "print_time": False, "ipopt": options})
    ocp.method(rockit.MultipleShooting(N=INTERVALS, M=1, intg="rk"))
    try:
        found = ocp.solve()
    except RuntimeError as error:
        raise RivalError(str(error).split("'")[-2:][0] or "no solution") from error
    knots = [np.asarray(found.sample(value, grid="control")[1]) for value in (*states, jerk)]
    times = np.asarray(found.sample(states[0], grid="control")[0], dtype=np.float64)

    def flat(t: Array) -> Array:
        piece = np.clip(np.searchsorted(times, t, side="right") - 1, 0, INTERVALS - 1)
        h = (t - times[piece])[:, None]
        x, v, a, j = (values[piece] for values in knots)
        return np.stack(
            [
                x + h * (v + h * (a / 2.0 + h * j / 6.0)),
                v + h * (a + h * j / 2.0),
                a + h * j,
                j,
            ],
            axis=-1,
        )

    return Solution(float(times[-1]), flat_sampler(task, flat))
