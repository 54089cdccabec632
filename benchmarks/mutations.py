"""Mutations of the certificate's code, each detected by a plan on which verify disagrees, or a test.

Usage: python -m benchmarks mutations [--plans DIR]

Every mutation is made in a copy of the package. What the mutated certificate says of a plan is held
against ``hitchopt.verify``: they disagree where one calls it good and the other does not, or where
a worst value differs by more than 2 % of itself or of its limit. Mutations that change no worst
value of a plan are held against a file of fast tests. ``--plans`` names a folder with
plans of the problems, to save solving them.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.values.fields import with_fields

ROOT = Path(__file__).parents[1]
TOLERANCE = 0.02
"""Maximum relative difference of worst values between certificate and verify."""

CHECK = """
import json, pathlib, sys
from hitchopt.checks import certify
from hitchopt.motion.plan_file import read_plan
found = certify(read_plan(pathlib.Path(sys.argv[1])), reports=())
rows = [[c.name, c.holds, c.worst, c.limit] for c in found.checks]
print(json.dumps([found.certified, rows]))
"""


class Mutation(NamedTuple):
    """A change of one line: below ``hitchopt/checks`` or, with a slash in front, below the package."""

    file: str
    old: str
    new: str
    plan: str  # name of a problem, or path of a test file below ``tests``, or of one test in it
    words: str

    @property
    def path(self) -> Path:
        """The file's path below the package."""
        return Path(self.file[1:] if self.file[0] == "/" else f"checks/{self.file}")


MUTATIONS = (
    Mutation("separation.py", "points, margin=margin, names=(names, names))", "points, margin=margin, names=(names, names), allowed=lambda i, j: j - i < 4)", "triangle", "pairs far apart in the list are missed"),
    Mutation("separation.py", "coefficients * scale[:, None]", "coefficients * scale[::-1, None]", "stack", "axes of the ellipsoid exchanged"),
    Mutation("/hitch/pairs.py", "own_end[:, None], axis=1)", "own_end[:, None], axis=1) & (i // 2 == (j - drones) // 3)", "triangle", "foreign cables missed"),
    Mutation("/hitch/pairs.py", "own_end[:, None], axis=1)", "own_end[:, None], axis=1) & (i // 2 != (j - drones) // 3)", "form_thirty_gon", "own edges missed"),
    Mutation("hanging.py", "level_depth = (self.length", "level_depth = 0.5 * (self.length", "form_pentagon", "hanging cables half as deep"),
    Mutation("crossing.py", "return flags", "return flags & (parts.part[first] // 3 != parts.part[second] // 3)", "grip_drum", "legs of one cable missed"),
    Mutation("spans.py", "by_time(derivative(part, order - 1)", "by_time(derivative(part, 0)", "triangle", "every derivative is the first"),
    Mutation("drones.py", "has_leg.ravel()[spans.item]", "has_leg.ravel()[spans.item] & (spans.item < 1)", "triangle", "legs but the first missed"),
    Mutation("cables.py", "- self.parts.norm) * exists", "- self.parts.norm) * (0.5 * exists)", "weight_hexagon", "a factor of the sag"),
    Mutation("cables.py", "length - self.scaled(savings)", "length + self.scaled(savings)", "carry_box", "sign of what rims save"),
    Mutation("grips.py", "diameter = 2.0 * rows", "diameter = 2.2 * rows", "grip_drum", "radius of arcs"),
    Mutation("cables.py", "drones[:, 0::2], noise=spans.noise).norm_upper", "0.9 * drones[:, 0::2] - 0.1 * drones[:, 1::2], noise=spans.noise).norm_upper", "form_triangle", "a factor of spans"),
    Mutation("convexity.py", "ahead.cross(behind)", "behind.cross(ahead)", "triangle", "sense of turning"),
    Mutation("arena.py", "np.concatenate([above_lower, below_upper], axis=2)", "below_upper", "tie_carry_untie", "lower walls missed"),
    Mutation("clearance.py", "yield pairs_with_shape(motion, points, drones.names, name, Solid(slab), pose)", "yield from ()", "grip_drum", "bodies missed"),
    Mutation("drone_forces.py", "hover = self.mass * GRAVITY", "hover = -self.mass * GRAVITY", "triangle", "sign of gravity"),
    Mutation("drone_forces.py", "return force + self.load if", "return force - self.load if", "transport", "sign of the cable's pull"),
    Mutation("drone_forces.py", "(half_density * self.scalar_of(sagging_tensions)", "(4.0 * half_density * self.scalar_of(sagging_tensions)", "weight_hexagon", "a factor of legs' weight"),
    Mutation("drones.py", "np.degrees(np.arctan2(horizontal, rise))", "np.degrees(np.arctan2(0.9 * horizontal, rise))", "triangle", "a factor of leaning"),
    Mutation("clasps.py", "-arriving[:, behind]", "arriving[:, behind]", "triangle", "sign of an edge"),
    Mutation("clasps.py", "half_loads = 0.5 * GRAVITY * team.load[", "half_loads = 0.0 * GRAVITY * team.load[", "weight_hexagon", "the load dropped"),
    Mutation("clasps.py", "0.5 * GRAVITY * team.cable_density", "1.0 * GRAVITY * team.cable_density", "weight_hexagon", "a factor of cables' weight"),
    Mutation("clasps.py", "force - self.half_load.sum()", "force + self.half_load.sum()", "weight_form_and_carry", "sign of a clasp's load"),
    Mutation("clasps.py", "self.half_load.along_z() - self.forces", "self.half_load.along_z() + self.forces", "weight_hexagon", "sign of a contact"),
    Mutation("/motion/loads.py", "return -body.mass * supports.shares", "return -0.5 * body.mass * supports.shares", "carry_box", "a factor of the object's weight"),
    Mutation("/motion/loads.py", "specific_forces[:, :, 2] += GRAVITY", "specific_forces[:, :, 2] -= GRAVITY", "carry_box", "sign of the object's weight"),
    Mutation("/motion/loads.py", "1.0 - np.cos(_rise_angle(team, mass, edges, tensions))", "0.0 * _rise_angle(team, mass, edges, tensions)", "carry_box", "the rim's strut dropped"),
    Mutation("friction.py", "np.exp(self.source.team.friction", "np.exp(-self.source.team.friction", "checks/test_friction.py", "sign of friction"),
    Mutation("cables.py", "high.value - largest * friction", "high.value - 0.9 * largest * friction", "checks/test_friction.py", "a factor of the range of tensions"),
    Mutation("/motion/cable_state.py", '"being tightened", linked=True, tied=True', '"being tightened"', "form_triangle", "clasped cables taken for free ones"),
    Mutation("chords.py", "spans.sign_after - spans.sign_before", "spans.sign_after + spans.sign_before", "form_triangle", "sign of crossings"),
    Mutation("support.py", "horizontal_acceleration.dot(inward) * height", "horizontal_acceleration.dot(inward) * 10.0 * height", "carry_box", "a factor of inertia leaning"),
    Mutation("support.py", "np.sum(inward * (centre[:2] - places), axis=-1)", "np.sum(inward * (places - centre[:2]), axis=-1)", "carry_box", "sign of the edge's distance"),
    Mutation("grips.py", "np.asarray(self.body.friction * np.sum(", "np.asarray(2.0 * self.body.friction * np.sum(", "grip_drum", "a factor of slip loads"),
    Mutation("grips.py", "(self.acceleration[2] + GRAVITY) * self.share", "self.acceleration[2] * self.share", "grip_drum", "the weight dropped"),
    Mutation("grips.py", "* add_axis(pull) * -SIGNS", "* add_axis(pull)", "grip_drum", "sign of a pull"),
    Mutation("clearance.py", "active=~is_holding)", "active=is_holding)", "carry_box", "cables that hold taken for others"),
    Mutation("linking.py", "length(left[:, 1:] - right[:, :-1])", "length(right[:, 1:] - left[:, :-1])", "triangle", "ends exchanged"),
    Mutation("downwash.py", "not body.fixed and grip <", "body.fixed and grip <", "checks/test_downwash.py", "downwash on what stands free missed"),
    Mutation("downwash.py", "grip = body.friction", "grip = 1e3 * body.friction", "checks/test_downwash.py", "a factor of what holds an object"),
    Mutation("downwash.py", "np.max(team.max_thrust)", "np.min(team.max_thrust)", "checks/test_downwash.py", "the weakest drone in place of the strongest"),
    Mutation("bodies.py", "np.where(turning, _middles(motion, drones), vertices)", "vertices", "checks/test_bodies.py", "clasps in place of pairs that turn"),
    Mutation("bodies.py", "0.5 * (q_ahead + r_behind)", "0.5 * q_ahead + 0.0 * r_behind", "checks/test_bodies.py", "a factor of middles of pairs"),
    Mutation("drones.py", "    over=Points,\n", "    over=Drones,\n", "triangle", "drones in place of vertices"),
    Mutation("hanging.py", "OWN_DISTANCES * (limit + 2.0 * requirements.limits.tube.level)", "OWN_DISTANCES * limit", "checks/test_own_cables.py", "own cables without errors of drones"),
    Mutation("crossing.py", "partial(_unclasped, motion.team.layout) if is_linked else None", "partial(_unclasped, motion.team.layout)", "checks/test_bodies.py", "neighbours of cables that are not linked missed"),
    Mutation("/verify/drones.py", "[*p.slabs, *p.walls]", "[*p.slabs]", "verify/test_limits.py::test_prisms_stand_in_the_way", "prisms missed"),
    Mutation("/verify/drones.py", "[*p.slabs, *p.walls]", "[*p.slabs, *p.walls[:1]]", "verify/test_limits.py::test_prisms_stand_in_the_way", "prisms but the first missed"),
    Mutation("/verify/drones.py", "error = s.plan.tracking ", "error = 0.0 ", "verify/test_limits.py::test_walls_are_as_far_as_drones_may_err", "errors of drones at walls dropped"),
    Mutation("/verify/drones.py", "[2] - error * s.plan.ratio", "[2] - error", "verify/test_limits.py::test_walls_are_as_far_as_drones_may_err", "vertical errors at ceilings taken for horizontal ones"),
    Mutation("/verify/drones.py", '(lim["reserve"] if k > 1 else 1.0)', "1.0", "verify/test_limits.py::test_reserves_are_left_for_stops", "reserves of stops dropped"),
    Mutation("/verify/drones.py", '(lim["reserve"] if k > 1 else 1.0)', '(lim["reserve"] if k > 2 else 1.0)', "verify/test_limits.py::test_reserves_are_left_for_stops", "reserves of accelerations dropped"),
    Mutation("/verify/drones.py", "(s.point(i, 2) + G * UP)", "(s.point(i, 2) + 0.9 * G * UP)", "verify/test_verify.py::test_it_agrees_with_the_certificate[triangle]", "a factor of gravity"),
    Mutation("/verify/drones.py", "lambda s, i: thrust(s, i).norm())", "lambda s, i: thrust(s, i)[:2].norm())", "verify/test_verify.py::test_it_agrees_with_the_certificate[triangle]", "upward thrust dropped"),
    Mutation("/verify/cables.py", "(0.25, 0.5, 0.75)], sag)", "(0.25, 0.5, 0.75)])", "verify/test_limits.py::test_cables_sag_toward_the_floor", "sag at walls dropped"),
    Mutation("/verify/cables.py", "np.where(ramp, 0.0, low)", "0.0", "verify/test_forged_files.py::test_every_cable_has_its_own_ramp", "smallest tensions dropped"),
    Mutation("/verify/cables.py", "-total_turn(s) + (361.0 if", "-total_turn(s) + (721.0 if", "verify/test_limits.py::test_outlines_turn_once", "two turns of an outline"),
    Mutation("/verify/cables.py", "shared = np.any(", "shared = np.all(", "verify/test_verify.py::test_it_agrees_with_the_certificate[triangle]", "parts that share a clasp taken for others"),
    Mutation("/verify/cables.py", 'limits["leg"] + 2.0 * p.tracking', 'limits["leg"]', "verify/test_limits.py::test_distances_are_wider_by_errors_of_drones", "errors of drones in legs dropped"),
    Mutation("/verify/plan.py", '("cable", 2.0), ("crossing", 2.0)', '("cable", 2.0), ("crossing", 1.0)', "verify/test_limits.py::test_distances_are_wider_by_errors_of_drones", "errors of one cable of two"),
    Mutation("/verify/plan.py", "np.array([wide + error, wide + error, high * self.ratio])", "np.array([wide, wide, high * self.ratio])", "verify/test_limits.py::test_ellipsoids_contain_those_of_drones_with_errors", "ellipsoids without errors of drones"),
    Mutation("/verify/plan.py", "if not low[q, k, 1 - start]:", "if True:", "verify/test_forged_files.py::test_tensions_rise_to_the_smallest_at_which_a_hitch_is_held", "ramps that end anywhere"),
    Mutation("/verify/plan.py", "not (rest[q] and low[q, k, start])", "not rest[q]", "verify/test_forged_files.py::test_what_dips_from_the_smallest_tension_and_back_is_no_ramp", "ramps that do not begin below the tension"),
    Mutation("/verify/consistency.py", "    for k, unit in enumerate(JUMP_UNITS):\n        points = p.points.c[k]", "    for k, unit in enumerate(JUMP_UNITS[:2]):\n        points = p.points.c[k]", "verify/test_limits.py::test_no_derivative_up_to_the_acceleration_jumps", "jumps of accelerations missed"),
    Mutation("/verify/driver.py", "broken = excess > TOLERANCE * max(abs(limit), 1.0)", "broken = False", "storage/test_stated_rules.py::test_a_rule_that_its_own_record_violates_is_violated", "stated rules hold, whatever their worst value"),
    Mutation("/verify/tying.py", "np.where((p.state != LOOSE)[s.piece, None], 2.0 * p.tracking, 0.0)", "0.0 * errs[s.piece, None]", "verify/test_limits.py::test_hanging_cables_are_longer_than_chords_with_errors", "errors of drones in spans dropped"),
    Mutation("/verify/spans.py", "verdict = \"violated\" if worst < target else \"not proven\"", "verdict = \"violated\" if worst < target else \"proven\"", "verify/test_verify.py::test_what_stays_undecided_is_not_proven", "what is not decided is proven"),
    Mutation("/verify/spans.py", "effort.spent > effort.allowed", "False", "verify/test_forged_files.py::test_proofs_share_their_effort", "no effort of all proofs"),
    Mutation("/verify/arithmetic.py", "turn = self.slope * self.deviation", "turn = 0.0 * self.deviation", "verify/test_verify.py::test_values_and_slopes_stay_within_their_bounds", "turns of directions dropped"),
    Mutation("/verify/arithmetic.py", "+ self.slope * o.deviation\n", "\n", "verify/test_verify.py::test_values_and_slopes_stay_within_their_bounds", "a term of products dropped"),
    Mutation("/verify/arithmetic.py", "q = np.max(np.abs(ends), 0) * self.q + q", "q = np.abs(slope[:, 0]) * self.q + q", "verify/test_verify.py::test_values_and_slopes_stay_within_their_bounds", "slopes of functions at midpoints alone"),
    Mutation("/verify/arithmetic.py", "np.max(np.where(candidate, rate, 0.0), axis=0)", "q[at]", "verify/test_verify.py::test_values_and_slopes_stay_within_their_bounds", "minima of several taken for one"),
    Mutation("/planners/timing/ramps.py", "4.0 * accelerations * distances", "3.0 * accelerations * distances", "planners/test_timing.py::test_fastest_ramps_are_those_of_the_clock", "peak speeds with a plateau"),
    Mutation("/planners/timing/ramps.py", "np.cbrt(0.25 * distances", "np.cbrt(0.2 * distances", "planners/test_timing.py::test_fastest_ramps_are_those_of_the_clock", "peak speeds without a plateau"),
    Mutation("/planners/timing/ramps.py", "rises_without = 2.0 * np.sqrt(peaks / jerk)", "rises_without = 1.9 * np.sqrt(peaks / jerk)", "planners/test_timing.py::test_fastest_ramps_are_those_of_the_clock", "times of rises without a plateau"),
    Mutation("/planners/timing/stretch.py", "(rate / allowed) ** (1.0 / order)", "(rate / allowed) ** 1.0", "planners/test_timing.py::test_a_rigid_shift_takes_the_known_time", "stretches of rates of any order alike"),
    Mutation("/planners/timing/stretch.py", "math.pow(excess, 1.0 / rule.derivative)", "math.pow(excess, 1.0)", "planners/test_timing.py::test_the_stretch_of_a_known_turn_is_exact", "stretches by records of any order alike"),
    Mutation("/planners/timing/stretch.py", "rule.name not in IN_ROWS", "rule.name in IN_ROWS", "planners/test_timing.py::test_a_flight_with_the_needed_stretch_just_keeps_its_limit", "limits without rows are not planned for"),
    Mutation("/planners/timing/profile.py", "fastest_drone / self.limits.speed", "0.5 * fastest_drone / self.limits.speed", "planners/test_timing.py::test_a_rigid_shift_takes_the_known_time", "half of drones' speeds"),
    Mutation("/planners/timing/profile.py", "math.tan(self.share * self.limits.tilt) ** 2", "math.tan(self.share * self.limits.tilt)", "planners/test_timing.py::test_one_limit_binds_near_the_optimal_duration", "cone of tilt"),
    Mutation("/planners/timing/clock.py", "1.5 * x1 * self.second", "0.5 * x1 * self.second", "planners/test_timing.py::test_jerks_on_a_clock_are_rates_of_accelerations", "a factor of jerk on a clock"),
    Mutation("/planners/timing/profile.py", "vertex_ratio = self.vertex_speed", "vertex_ratio = 0.5 * self.vertex_speed", "planners/test_timing.py::test_one_limit_binds_near_the_optimal_duration", "half of vertices' speeds"),
)  # fmt: skip


@cache
def plan(name: str, folder: Path) -> Path:
    """Return the path of a problem's plan, solved unless the folder has it.

    Drones fly without errors: the second opinion's distances are wider for them, and compare with
    those of the certificate only without.
    """
    path = folder / name / "plan.npz"
    if not path.exists():
        problems = ROOT / "problems"
        source = next(
            p for p in (problems / f"{name}.yaml", problems / f"swarms/{name}.yaml") if p.exists()
        )
        problem = ho.load_problem(source)
        exact = replace(problem, limits=with_fields(problem.limits, tracking=0.0))
        ho.solve(exact).save(path.parent, rate=10.0)
    return path


@cache
def opinion(path: Path) -> dict[str, Any]:
    """Return verify's worst values for the limits of the certificate."""
    rows = [row for row in second.verify(path) if row.unit not in ("turn", "wrap", "bend")]
    assert all(row.verdict == "proven" for row in rows), path
    return {row.name: row for row in rows}


def disagreement(package: Path, path: Path) -> str:
    """Return the disagreement of a package's certificate with verify on a plan, or nothing."""
    command = [sys.executable, "-c", CHECK, str(path)]
    environment = {**os.environ, "PYTHONPATH": str(package), "PYTHONDONTWRITEBYTECODE": "1"}
    process = subprocess.run(
        command, capture_output=True, text=True, env=environment, cwd=package, check=False
    )
    if process.returncode:
        return "it ends with " + (process.stderr.strip().splitlines() or ["no word"])[-1][:60]
    certified, checks = json.loads(process.stdout)
    for name, holds, worst, limit in checks:
        row = opinion(path).get(name)
        if row is None or limit is None:
            continue
        value = row.worst * limit if row.unit == "share" else row.worst
        if not holds:
            return f"{name}: refused with {worst:.4g}, proven with {value:.4g}"
        if abs(worst - value) > TOLERANCE * max(abs(value), abs(limit), 1e-6):
            return f"{name}: {worst:.4g}, and {value:.4g}"
    return "" if certified else "not certified"


def failure(package: Path, tests: str, plans: Path) -> str:
    """Return the first fast test of a file that fails with a package, or nothing.

    ``plans`` is the folder of plans that tests share.
    """
    options = ["-q", "-x", "-n", "0", "-p", "no:cacheprovider", "-m", "not slow"]
    command = [sys.executable, "-m", "pytest", *options, f"tests/{tests}"]
    environment = {
        **os.environ,
        "PYTHONPATH": str(package),
        "PYTHONDONTWRITEBYTECODE": "1",
        "HITCHOPT_TESTED_PLANS": str(plans),
    }
    process = subprocess.run(
        command, capture_output=True, text=True, env=environment, cwd=package, check=False
    )
    failed = [line for line in process.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    if failed:
        return failed[0].rpartition("::")[2][:60]
    return f"pytest ends with {process.returncode}" if process.returncode else ""


def finding(package: Path, mutation: Mutation, folder: Path) -> str:
    """Return what a package's certificate is found by: a plan, or a test; nothing if it is sound.

    Mutants of ``verify`` share the plans of their tests, which it does not change; every other one
    plans anew.
    """
    if ".py" in mutation.plan:
        if mutation.file.startswith("/verify/"):
            return failure(package, mutation.plan, folder / "of_tests")
        with tempfile.TemporaryDirectory() as own:
            return failure(package, mutation.plan, Path(own))
    return disagreement(package, plan(mutation.plan, folder))


def main() -> int:
    """Print the table of all mutations."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plans", type=Path, default=None)
    parser.add_argument(
        "--only", nargs="+", default=[""], help="parts of words or paths of the mutations to make"
    )
    options = parser.parse_args()
    mutations = [
        each
        for each in MUTATIONS
        if any(part in f"{each.words} ({each.path})" for part in options.only)
    ]
    missed = 0
    with tempfile.TemporaryDirectory() as temporary:
        folder, package = options.plans or Path(temporary) / "plans", Path(temporary) / "package"
        ignore = shutil.ignore_patterns("__pycache__")
        for part in ("hitchopt", "tests", "problems", "benchmarks"):
            shutil.copytree(ROOT / part, package / part, ignore=ignore)
        shutil.copy(ROOT / "pyproject.toml", package)
        for name, each in {each.plan: each for each in mutations}.items():
            assert not finding(package, each, folder), name
        print("| mutation | plan | disagreement |\n|---|---|---|")
        for each in mutations:
            file = package / "hitchopt" / each.path
            text = file.read_text(encoding="utf-8")
            file.write_text(text.replace(each.old, each.new), encoding="utf-8")
            difference = finding(package, each, folder)
            file.write_text(text, encoding="utf-8")
            missed += not difference
            print(
                f"| {each.words} ({each.path}) | {each.plan} | {difference or 'NONE'} |", flush=True
            )
    print(f"\n{len(mutations) - missed} of {len(mutations)} are found")
    return 1 if missed else 0
