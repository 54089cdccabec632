"""Half of the paper's experiment 2, without its wait, simulated: table in LaTeX, and figures."""

import hitchopt as ho

team = ho.Team(robots=3, cable_length=2.4, cable_density=0.01, quadrotor="paper_132g")
limits = ho.Limits(tracking=0.03)  # [m] how far all drones may be off at once
start = ho.Hitch.spread(team, [[0, -1], [-0.4, 0.5], [0.4, 0.5]], altitude=1.0, limits=limits)
path = [[0, 0, -1], [1, 0, -0.975], [3, 0, -0.875], [5, 0, -0.775], [6, 0, -0.75]]  # t, x, y
plan = ho.solve(start, ho.FollowVertex(0, path), limits=limits)
plan.save("experiment_2")
plan.view("experiment_2/plan.pdf", width=3.5)  # [inch]

flight = ho.simulate(plan, perturbed=True, seed=1, preset="fast")
flight.save("experiment_2/simulation")
flown = ho.evaluate("experiment_2/simulation", "experiment_2")
flown.save("experiment_2/evaluation", format="pdf", width=3.5)
print(flown.sag)
assert "do not include it" in flown.sag
for row in flown.short_table:
    if row.phase == "all" and row.name.startswith("p"):
        print(f"{row.name}: {1e3 * row.mean:.0f} ± {1e3 * row.std:.0f} mm")
        assert row.std < row.mean + row.std < 0.1
