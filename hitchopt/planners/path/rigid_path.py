"""The path of a whole hitch that is carried and turned without a change of shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.hitch import Hitch, Team
from hitchopt.model.evaluation import FlatJets
from hitchopt.model.robot import JET
from hitchopt.values import Array


@dataclass(frozen=True, eq=False)
class RigidPath:
    """Centroid on a straight line, the hitch turning about it; both linear in s.

    Parameters
    ----------
    start: the hitch at s = 0.
    to: (3,) [m], where its centroid is at s = 1.
    yaw: by how much it turns until then, counter-clockwise [rad]; more than a turn is one.
    """

    start: Hitch
    to: Array
    yaw: float

    @property
    def team(self) -> Team:
        """Whose cables."""
        return self.start.team

    @property
    def centroid(self) -> Array:
        """(3,) [m]: where the centroid is at s = 0."""
        return np.append(self.start.polygon.centroid, self.start.altitude)

    @property
    def still(self) -> bool:
        """Whether nothing moves."""
        return self.yaw == 0.0 and bool(np.max(np.abs(self.to - self.centroid)) < 1e-9)

    def flat(self, s: Array, count: int = JET) -> FlatJets:
        """Return the flat outputs' jets by s at s (J,), of ``count`` numbers each."""
        hitch = self.start
        arms = hitch.vertices[:, :2] - self.centroid[:2]
        vertices = np.zeros((len(s), len(arms), 3, count))
        for order in range(count):  # each derivative of a rotation is a quarter turn ahead
            angle = self.yaw * s + 0.5 * np.pi * order
            c, sin = self.yaw**order * np.cos(angle), self.yaw**order * np.sin(angle)
            vertices[:, :, 0, order] = c[:, None] * arms[:, 0] - sin[:, None] * arms[:, 1]
            vertices[:, :, 1, order] = sin[:, None] * arms[:, 0] + c[:, None] * arms[:, 1]
        offset = self.to - self.centroid
        vertices[..., 0] += (self.centroid + s[:, None] * offset)[:, None]
        vertices[..., 1:2] += offset[:, None]
        q_legs = np.zeros((len(s), self.team.robots, count))
        q_legs[..., 0] = hitch.q_legs
        tensions = np.zeros_like(q_legs)
        tensions[..., 0] = self.team.tension
        roll = None
        if np.any(hitch.roll):
            roll = np.zeros((len(s), len(hitch.roll), count))
            roll[..., 0] = hitch.roll
        return FlatJets(vertices, q_legs, tensions, roll)
