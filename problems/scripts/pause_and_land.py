"""Pause a plan in flight, go on, and land from wherever it is."""

import hitchopt as ho

team = ho.Team(robots=3, cable_length=2.4)
start = ho.Hitch.spread(team, [[0, -1], [-0.4, 0.5], [0.4, 0.5]], altitude=1.2)
plan = ho.solve(start, ho.Transport(to=[1.5, 0.0, 1.2]))

player = ho.Player(plan)
player.step(0.8)
rest = player.pause()
while not player.resting:
    setpoints = player.step(0.01)  # send these to the drones
print(f"at rest {rest:.2f} s after the command")
player.resume()
setpoints = player.step(1.0)
speed = abs(setpoints.velocities).max()
print(f"a second later again at {speed:.2f} m/s")
assert 0.0 < rest <= plan.certificate["stoppable"].worst
assert speed > 0.1

landed = plan.abort(0.8, "land")
landed.certificate.raise_if_violated()
height = landed.at(landed.duration).positions[:, 2].max()
print(f"landed after {landed.duration:.1f} s, {height:.3f} m above the ground")
assert height < 1e-6 < landed.duration
