"""Pull a vertex of a triangle in, and draw the plan from above and its speeds over time."""

import matplotlib.pyplot as plt
import numpy as np

import hitchopt as ho

team = ho.Team(robots=3, cable_length=2.4)  # [m]
start = ho.Hitch.spread(team, [[0, -1], [-0.4, 0.5], [0.4, 0.5]], altitude=1.0)
plan = ho.morph(start, [[0, -0.5], [-0.4, 0.5], [0.4, 0.5]])

t = np.linspace(0.0, plan.duration, 400)
speeds = np.linalg.norm(plan.at(t).velocities, axis=-1)  # (times, drones) [m/s]
figure, (above, over_time) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
plan.plot(above)
over_time.plot(t, speeds, label=team.drone_names)
over_time.axhline(plan.certificate["speed"].worst, color="0.5", ls="--", label="certified")
over_time.set(xlabel="t [s]", ylabel="speed [m/s]")
over_time.legend(ncols=2, fontsize="small")
figure.savefig("morph.png", dpi=150)

bound = plan.certificate["speed"].worst
print(
    f"{plan.duration:.2f} s; no drone is faster than {bound:.3f} m/s, samples: {speeds.max():.3f}"
)
assert plan.certificate.certified
assert 1.2 < plan.duration < 1.4
assert speeds.max() <= bound < 1.01 * speeds.max()
