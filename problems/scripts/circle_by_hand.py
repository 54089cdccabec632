"""Move a vertex on a circle along a custom path, then time and certify it."""

import numpy as np

import hitchopt as ho

team = ho.Team(robots=3, cable_length=2.4)


def triangle(s: float) -> list[list[float]]:
    """Return the vertices [m] at s."""
    angle = 2 * np.pi * s
    return [[0.15 * np.sin(angle), -0.6 - 0.15 * np.cos(angle)], [-0.6, 0.4], [0.6, 0.4]]


path = ho.Path.of(team, vertices=triangle)
motion = ho.time(path, limits=ho.Limits(vertex_speed=0.3))
certificate = ho.certify(motion)
print(f"{motion.duration:.2f} s; certified: {certificate.certified}")
assert certificate.certified
assert 3.1 < motion.duration < 3.8
