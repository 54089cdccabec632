"""Fly a hitch of Crazyflies and threads in MuJoCo, with noise and wind, as uploaded."""

import hitchopt as ho

team = ho.Team(
    robots=3, cable_length=2.4, cable_density=0.0015, quadrotor="crazyflie_2.1_brushless"
)
start = ho.Hitch.spread(team, [[0, 0.58], [0.5, -0.29], [-0.5, -0.29]], altitude=1.2)
plan = ho.solve(start, ho.Hold(1.0))
plan.save("threads")

flight = ho.simulate(plan, perturbed=True, upload=True, seed=1)
print("holds" if flight.outcome.hitched else flight.run.failures)
assert flight.outcome.hitched
errors = 100.0 * flight.errors.errors  # (times, vertices) [cm]
print(f"vertices are {errors.mean():.1f} cm off on average, {errors.max():.1f} cm at most")
assert errors.mean() < errors.max() < 30.0
