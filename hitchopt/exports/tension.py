"""Policies by which drones that fly exported files hold the tension of their cables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.exports.format import Format
from hitchopt.exports.held_tension import is_overridden
from hitchopt.exports.options import ExportOptions
from hitchopt.hitch import Team
from hitchopt.hitch.forces import INTEGRAL, SLACK, undetermined_tension
from hitchopt.motion.flight import Flight


@dataclass(frozen=True)
class TensionPolicy:
    """The policy that holds the tension of cables in flights of a format's files.

    Drones hold it if they get the cable forces and add them, or by offsets of their setpoints,
    which need the stiffness of their position loops.
    """

    teams: tuple[Team, ...]  # Teams that form a hitch
    is_flown: bool  # True if drones fly the files
    sends_forces: bool  # True if receivers get the cable forces
    # True if tensions are lost unless the stiffness of position loops is known
    needs_stiffness: bool
    wants_offsets: bool  # True if the options request offsets in formats that do not require them
    # Stiffness of all position loops that the options state [N/m]; None for the teams'
    stiffness: float | None

    @classmethod
    def of(cls, kind: Format, flight: Flight, options: ExportOptions) -> TensionPolicy:
        """Return the policy of a format for a flight."""
        motions = (flown.motion for flown in flight.teams)
        return cls(
            teams=tuple(motion.team for motion in motions if np.any(motion.formed)),
            is_flown=bool(kind.flown_by),
            sends_forces=kind.flown_by != "upload" and not options.positions_only,
            needs_stiffness=kind.needs_stiffness or options.positions_only,
            wants_offsets=options.hold_tension,
            stiffness=options.stiffness,
        )

    def takes_force(self, team: Team) -> bool:
        """Return whether a team's drones get the cable forces, and add them."""
        return self.sends_forces and bool(np.all(team.feed_forward))

    def knows_stiffness(self, team: Team) -> bool:
        """Return whether the stiffness of a team's position loops is known."""
        return self.stiffness is not None or bool(np.all(np.isfinite(team.stiffness)))

    @property
    def needs_offsets(self) -> bool:
        """Return whether setpoints have to hold the tension."""
        is_taken = all(map(self.takes_force, self.teams))
        return self.wants_offsets or (self.needs_stiffness and not is_taken)

    @property
    def is_overridden(self) -> bool:
        """Return whether integral gains would pull drones to moved setpoints at any tension."""
        return any(map(is_overridden, self.teams))

    @property
    def slack_reason(self) -> str:
        """Why drones lose the tension; empty if they hold it."""
        if not self.needs_stiffness:
            return ""
        if self.needs_offsets and self.is_overridden:
            return INTEGRAL
        return "" if all(map(self.knows_stiffness, self.teams)) else SLACK

    def undetermined_reasons(self, *, has_offsets: bool) -> tuple[str, ...]:
        """Return why files, with offsets or without, leave the tension undetermined, if they do."""
        reasons = list[str]()
        for team in self.teams if self.is_flown else ():
            is_trusted = not self.needs_stiffness or self.knows_stiffness(team)
            reasons += undetermined_tension(
                integral=bool(np.any(np.isinf(team.integral[:, :2]))),  # level
                feed_forward=has_offsets or (is_trusted and self.takes_force(team)),
            )
        return tuple(dict.fromkeys(reasons))
