"""The table of checks, and the page with their facts from the registry and formulas."""

from __future__ import annotations

import inspect
from typing import Any

from hitchopt.checks.registry import QUANTITIES, REPORTS, RULES
from hitchopt.checks.rule import CheckRule, FlightReport, ReportRule, WorstOverSpans
from hitchopt.motion.cable_state import STATES

SENSES = {"min": "must not fall below the limit", "max": "must not rise above the limit"}


INTRODUCTION = """# Checks and formulas

What the registry says of every check of {doc}`the certificate </explanation/certificate>`, and the code that computes it, over
`Enclosed` values: polynomials with the radius of a ball around them.
"""


def write_check_table() -> str:
    """Return the table of what each check proves, and what not."""
    rows = [f"| `{each.name}` | {each.proves} | {each.unproven} |" for each in QUANTITIES]
    return "\n".join(["| check | bounds, for all t | does not prove |", "|---|---|---|", *rows, ""])


def write_check_facts() -> dict[str, str]:
    """Return a table for each check and each report, by name."""
    facts = {rule.name: _table(_facts_of_check(rule)) for rule in RULES}
    return facts | {rule.name: _table(_facts_of_report(rule)) for rule in REPORTS}


def write_check_page() -> str:
    """Return the page with the facts of all checks and the code of their formulas."""
    codes = {rule.name: _formulas(rule) for rule in RULES}
    sections = [INTRODUCTION]
    for name, facts in write_check_facts().items():
        sections.append(f"\n(check-{name})=\n## `{name}`\n\n{facts}")
        if code := codes.get(name):
            sections.append(f"\n```python\n{code}\n```\n")
    return "".join(sections)


def _facts_of_check(rule: CheckRule) -> dict[str, str]:
    states = [str(state) for state in STATES if any(e.applies(state) for e in rule.evaluators)]
    names = "in any state" if len(states) == len(STATES) else ", ".join(states)
    exported = any(evaluator.exported for evaluator in rule.evaluators)
    limit = ""
    if rule.exported_share != 1.0:
        limit = f", against {rule.exported_share:g} times the limit"
    elif rule.exported_slack:
        limit = f", against a limit lower by {rule.exported_slack:g} {rule.unit}"
    free_remedy = rule.free_remedy if rule.free_remedy != rule.remedy else ""
    return {
        "`worst`": f"{_unit(rule.unit)}; {SENSES[rule.sense]}",
        "limit": _limit(rule),
        "while cables are": names,
        "checked in exports": f"yes{limit}" if exported else "no",
        "what helps": rule.remedy + (f"; while cables hang: {free_remedy}" if free_remedy else ""),
    }


def _facts_of_report(rule: ReportRule | FlightReport) -> dict[str, str]:
    limit = f"`{rule.key}`, if stated; otherwise" if rule.key else "none:"
    limit += " it is only reported"
    return {"`worst`": _unit(rule.unit), "limit": limit}


def _limit(rule: CheckRule) -> str:
    """Return the limit of a check, or the key that sets it."""
    if not callable(rule.limit):
        return f"{rule.limit:g}"
    return f"`{rule.key}`" if rule.key else "set by the problem"


def _formulas(rule: CheckRule) -> str:
    """Return the code of a check's distinct formulas; empty without one."""
    formulas: list[Any] = []
    for evaluator in rule.evaluators:
        if isinstance(evaluator.evaluate, WorstOverSpans):
            formulas.append(evaluator.evaluate.formula)
        formulas += evaluator.formulas
    unique = [getattr(each, "func", each) for each in dict.fromkeys(formulas)]
    return "\n\n".join(inspect.cleandoc(f"\n{inspect.getsource(each)}") for each in unique)


def _table(rows: dict[str, str]) -> str:
    lines = [f"| {key} | {text} |" for key, text in rows.items()]
    return "\n".join(["| | |", "|---|---|", *lines, ""])


def _unit(unit: str) -> str:
    return {"1": "a number", "ratio": "a ratio", "": "a number"}.get(unit, f"in {unit}")
