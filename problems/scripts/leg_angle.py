"""Certify a limit of one's own for all t: the angle between the two legs at a clasp."""

import hitchopt as ho

leg_angle = ho.Rule(
    "leg_angle", "deg", "min", 35.0, ho.ClaspSpans, lambda clasp: clasp.q_leg.angle_to(clasp.r_leg)
)
team = ho.Team(robots=3, cable_length=2.4)
start = ho.Hitch.spread(team, [[0, -0.5], [-0.4, 0.5], [0.4, 0.5]])
plan = ho.morph(start, [[0, -0.7], [-0.4, 0.5], [0.4, 0.5]])
check = ho.certify(plan, rules=[leg_angle])["leg_angle"]
print(f"smallest angle: {check.worst:.3f} deg at {check.where[0]}, {check.time:.2f} s")
assert check.holds
