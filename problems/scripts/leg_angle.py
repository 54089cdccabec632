"""Limit the angle between the two legs at a clasp for all t, and refuse plans that violate it."""

import hitchopt as ho

leg_angle = ho.Rule(
    "leg_angle", "deg", "min", 35.0, ho.ClaspSpans, lambda clasp: clasp.q_leg.angle_to(clasp.r_leg)
)
team = ho.Team(robots=3, cable_length=2.4)
start = ho.Hitch.spread(team, [[0, -0.5], [-0.4, 0.5], [0.4, 0.5]])
narrow = ho.Morph([[0, -0.7], [-0.4, 0.5], [0.4, 0.5]])
check = ho.solve(start, narrow, rules=[leg_angle]).certificate["leg_angle"]
print(f"smallest angle: {check.worst:.3f} deg at {check.where[0]}, {check.time:.2f} s")
broken = ""
try:
    ho.solve(start, ho.Morph([[0, -0.9], [-0.4, 0.5], [0.4, 0.5]]), rules=[leg_angle])
except ho.InfeasibleError as error:
    broken = error.violations[0].constraint
    print(f"refused: {broken}")
assert check.holds
assert broken == "leg_angle"
