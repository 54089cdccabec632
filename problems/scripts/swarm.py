"""Let eight drones without cables swap positions through the centre of a circle."""

import numpy as np

import hitchopt as ho

angles = 2.0 * np.pi * np.arange(8) / 8
ring = np.column_stack([1.5 * np.cos(angles), 1.5 * np.sin(angles), np.full(8, 1.2)])  # [m]
plan = ho.separate(ho.Problem(ho.Swarm(8), ring, [ho.Fly(ring * [-1, -1, 1])]))
plan.save("swarm")

closest = ho.closest(plan, spans=4, picture="closest.png")
pair = closest.pairs[0]
print(
    f"{plan.duration:.2f} s; closest: {pair.pair[0]}, {pair.pair[1]}, {pair.bound:.3f} ellipsoids"
)
assert plan.certificate.certified
assert pair.bound >= 1.0 - 1e-9
assert np.allclose(plan.at(plan.duration).positions, ring * [-1, -1, 1])
