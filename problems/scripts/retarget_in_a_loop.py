"""Steer a hitch in flight: a new goal every half second, each answer certified at once."""

import numpy as np

import hitchopt as ho

team = ho.Team(robots=3, cable_length=2.4)
start = ho.Hitch.spread(team, [[0, -1], [-0.4, 0.5], [0.4, 0.5]], altitude=1.0)
steering = ho.Replanner(team, start)
angles = 0.5 * np.arange(6)  # goals along a circle
goals = np.stack([0.8 * np.sin(angles), 0.8 * (1 - np.cos(angles)), 1 + 0.1 * angles], axis=1)
answers = []
for k, goal in enumerate(goals):
    answer = steering.retarget(to=goal, at=0.5 * (k + 1))
    print(f"goal {k}: {'accepted' if answer.accepted else answer.reason}")
    assert answer.accepted
    answers.append(answer)

plan = answers[-1].plan  # all of it, from the beginning
plan.certificate.raise_if_violated()
middle = plan.at(plan.duration).vertices.mean(axis=0)
print(f"{plan.duration:.2f} s; ends at {middle.round(3).tolist()}")
assert np.allclose(middle, goals[-1], atol=1e-6)
assert plan.duration > 3.0
