"""Plan every combination of tension and cable length, and print which limit excludes the others."""

import hitchopt as ho

start = {"hitch": {"polygon": [[0, -1], [-0.4, 0.5], [0.4, 0.5]], "altitude": 1.0}}
mission = [{"morph": {"polygon": [[0, -0.5], [-0.4, 0.5], [0.4, 0.5]]}}]
parameters = {"team.tension": [0.3, 0.6, 2.5], "team.cable_length": [2.2, 2.4]}

for tension in parameters["team.tension"]:
    for length in parameters["team.cable_length"]:
        team = {"robots": 3, "tension": tension, "cable_length": length}
        problem = {"team": team, "start": start, "mission": mission}
        try:
            plan = ho.solve(ho.problem_from_dict(problem))
            result = f"{plan.duration:.2f} s"
        except ho.InfeasibleError as error:
            result = f"no plan: {error.violations[0].constraint}"
        print(f"{tension} N, {length} m: {result}")
        assert result.startswith("no plan") == (tension > 1.29)
