"""Players that fly on after the loss of a robot."""

from __future__ import annotations

from hitchopt.live import player
from hitchopt.losses.losing import after_loss_at_rest, check_loss


class Player(player.Player):
    """A plan flown on a clock that all drones share, also after the loss of a robot.

    Paths, separations, clearances and crossings are those of the plan at every rate. Every change
    of the rate is verified for its whole duration before it starts: acceleration, jerk, thrust,
    tilt and body rates keep their limits, and a held object its balance. If a change cannot start
    at once, the clock continues until it can.

    Parameters
    ----------
    plan: a plan, its flight, or the motion of a team; players of the same one share computed data.
    time: initial plan time [s].
    rate: initial rate of the clock, from -1 to 1.

    Raises
    ------
    InputError: the time is outside the plan, or the rate out of range.
    UnsupportedError: other plans fly at the same time, on separate clocks.
    """

    def lose(self, robot: int | str) -> float:
        """Stop after the loss of a robot, and fly on as ``Plan.after_loss`` plans from there.

        All stop as soon as the limits allow; then the robot's drones rise, and the others form the
        chain. Return the time until it is held [s]. Setpoints keep their order; from the rest on,
        ``flight`` and ``time`` are those of what follows.

        Raises
        ------
        InputError: as ``Plan.after_loss``; the clock continues.
        InfeasibleError: a limit that is not kept after the loss; the clock stops.
        """
        time = self.time
        check_loss(self.flight, str(robot), time)
        seconds = self.pause()
        found = after_loss_at_rest(self.flight, str(robot), time, self.rest)
        self.follow(found.flight, found.drones)
        return seconds + found.flight.duration
