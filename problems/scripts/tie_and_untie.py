"""Tie a triangle from drones on the ground, turn it in the air, untie it and land."""

import numpy as np

import hitchopt as ho

team = ho.Team(robots=3, cable_length=2.4, cable_density=0.01, quadrotor="paper_132g")
q = [[-0.6, -1.2, 0], [-0.6, 0, 0], [-0.6, 1.2, 0]]  # [m], cables lie from q to r
r = [[0.6, -1.2, 0], [0.6, 0, 0], [0.6, 1.2, 0]]

mission = [
    ho.Form([[0, 0.6], [0.5, -0.3], [-0.5, -0.3]], altitude=1.5),
    ho.Transport([0.5, 0.0, 1.5], yaw=np.radians(40)),
    ho.Release(),
    ho.Land(),
]
plan = ho.solve(ho.DronesStart(q, r), mission, team=team, title="Tie and untie")
plan.save("tied")

for phase in plan.phases:
    print(f"{phase.start:6.2f} s  {phase.name:10} cables {phase.state}")
    assert phase.start < phase.end <= plan.duration
heights = plan.at(plan.duration).positions[:, 2]
print(f"all drones end at a height of {abs(heights).max():.3f} m")
assert abs(heights).max() < 1e-6
