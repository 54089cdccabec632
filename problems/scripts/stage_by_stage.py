"""Search a route, time it twice and certify it, as a morph does in one call."""

import hitchopt as ho

team = ho.Team(robots=4, cable_length=2.4)
start = ho.Hitch.spread(team, ho.regular_polygon(4, 1.2))
goal = ho.regular_polygon(4, 1.2).rotated(1.0)
path = ho.route(start, goal)
motion, slow = ho.time(path), ho.time(path, limits=ho.Limits(speed=0.3))
certificate = ho.certify(motion)
plan = ho.morph(start, goal)
print(f"{motion.duration:.2f} s, and {slow.duration:.2f} s at 0.3 m/s: {certificate.certified}")
assert certificate.certified
assert motion.duration == plan.duration < slow.duration
