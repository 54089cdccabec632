"""The page that says what works with what, from the declaration of all refusals."""

from __future__ import annotations

import re

from hitchopt.support import REFUSALS, Feature, Neighbour, Refusal

INTRODUCTION = """# What works with what

A number is a refusal, in the words below; all other combinations are supported, within their {doc}`limits </explanation/limitations>`.
"""


def write_support_page() -> str:
    """Return the page: a table of features by neighbours, and the words of each refusal."""
    numbers = {refusal: i for i, refusal in enumerate(dict.fromkeys(REFUSALS.values()), 1)}
    rows = ["| | " + " | ".join(Neighbour) + " |", "|---" * (len(Neighbour) + 1) + "|"]
    for feature in Feature:
        found = (REFUSALS.get((feature, neighbour)) for neighbour in Neighbour)
        cells = ["" if each is None else f"{numbers[each]}" for each in found]
        rows.append(f"| {feature} | " + " | ".join(cells) + " |")
    notes = [f"{i}. {_words(refusal)}." for refusal, i in numbers.items()]
    return "\n".join([INTRODUCTION, *rows, "", *notes, ""])


def _words(refusal: Refusal) -> str:
    """Return the words of a refusal, with an ellipsis for what is refused."""
    text = f"`{refusal.key}` must be {refusal}" if refusal.key else str(refusal)
    return re.sub(r"\{\w+\}", "…", text)
