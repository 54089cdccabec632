"""Ask for the smallest changes that make an infeasible problem feasible, and take the first."""

import hitchopt as ho

problem = ho.problem_from_dict(
    {
        "title": "Experiment 1 as printed",
        "team": {"robots": 3, "cable_length": 2.0},
        "start": {"hitch": {"polygon": [[0, -1], [-0.9, 0.4], [0.9, 0.4]], "altitude": 0.5}},
        "mission": [{"hold": {"seconds": 1.0}}],
    }
)
try:
    ho.solve(problem)
except ho.InfeasibleError as error:
    worst = error.violations[0]
    print(f"{worst.constraint} is {worst.value:.3f} at {' and '.join(worst.where)}")
    assert (worst.constraint, worst.limit) == ("separation", 1.0)

suggestions = ho.suggestions(problem)
for suggestion in suggestions:
    print(suggestion)
    assert "certified" in str(suggestion)
plan = ho.repair(problem)
print(f"repaired: {plan.duration:.1f} s, certified: {plan.certificate.certified}")
assert suggestions
assert plan.certificate.certified
assert plan.duration == 1.0
