"""Steer a hitch in flight: a new goal every half second, each answer certified at once."""

import numpy as np

import hitchopt as ho

team = ho.Team(robots=3, cable_length=2.4)
start = ho.Hitch.spread(team, [[0, -1], [-0.4, 0.5], [0.4, 0.5]], altitude=1.0)
steering = ho.Replanner(team, start)
for k in range(6):
    angle = 0.5 * k  # a goal that moves along a circle
    goal = [0.8 * np.sin(angle), 0.8 * (1.0 - np.cos(angle)), 1.0 + 0.05 * k]
    answer = steering.retarget(to=goal, at=0.5 * (k + 1))
    print(f"goal {k}: {'accepted' if answer.accepted else answer.reason}")
    assert answer.accepted

plan = answer.plan  # all of it, from the beginning
plan.certificate.raise_if_violated()
middle = plan.at(plan.duration).vertices.mean(axis=0)
print(f"{plan.duration:.2f} s; ends at {middle.round(3).tolist()}")
assert np.allclose(middle, goal, atol=1e-6)
assert plan.duration > 3.0
