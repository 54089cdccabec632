"""What the registry knows of every check, as a small table that its section includes."""

from __future__ import annotations

import inspect
from typing import Any

from hitchopt.checks.registry import REPORTS, RULES
from hitchopt.checks.rule import CheckRule, ReportRule, WorstOverSpans
from hitchopt.motion.motion import CableState

SENSES = {"min": "must not fall below the limit", "max": "must not rise above the limit"}


def write_check_facts() -> dict[str, str]:
    """Return one table for every check and every report, by its name."""
    facts = {rule.name: _facts_of_check(rule) for rule in RULES}
    return facts | {rule.name: _facts_of_report(rule) for rule in REPORTS}


def _facts_of_check(rule: CheckRule) -> str:
    rows = {
        "`worst`": f"{_unit(rule.unit)}; {SENSES[rule.sense]}",
        "limit": "set by the problem" if callable(rule.limit) else f"{rule.limit:g}",
        "while cables are": _states(rule),
        "held by exports": _exports(rule),
        "what eases it": _remedy(rule),
    }
    return _table(rows) + _formulas(rule)


def _formulas(rule: CheckRule) -> str:
    """Return the code of a check's formulas, each once."""
    found: list[Any] = []
    for evaluator in rule.evaluators:
        found += (
            [evaluator.evaluate.formula] if isinstance(evaluator.evaluate, WorstOverSpans) else []
        )
        found += evaluator.shown
    code = [
        inspect.cleandoc("\n" + inspect.getsource(getattr(each, "func", each)))
        for each in dict.fromkeys(found)
    ]
    return "" if not code else "\n```python\n" + "\n\n".join(code) + "\n```\n"


def _facts_of_report(rule: ReportRule) -> str:
    limit = "`limits.tracking`, if stated; else it is only reported"
    limit = limit if rule.remedy else "none: it is only reported"
    return _table({"`worst`": _unit(rule.unit), "limit": limit})


def _table(rows: dict[str, str]) -> str:
    lines = [f"| {key} | {text} |" for key, text in rows.items()]
    return "\n".join(["| | |", "|---|---|", *lines, ""])


def _unit(unit: str) -> str:
    return {"1": "a number", "ratio": "a ratio", "": "a number"}.get(unit, f"in {unit}")


def _states(rule: CheckRule) -> str:
    states = {state for evaluator in rule.evaluators for state in evaluator.states}
    if states == set(CableState):
        return "in any state"
    return ", ".join(state.name.lower() for state in CableState if state in states)


def _exports(rule: CheckRule) -> str:
    if not any(evaluator.exported for evaluator in rule.evaluators):
        return "no"
    return "yes" if rule.exported_limit is None else f"yes, against {rule.exported_limit:g}"


def _remedy(rule: CheckRule) -> str:
    if not rule.free_remedy or rule.free_remedy == rule.remedy:
        return rule.remedy
    return f"{rule.remedy}; while cables hang: {rule.free_remedy}"
