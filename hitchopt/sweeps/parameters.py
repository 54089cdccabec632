"""Parameters of a study: key paths, the values that they take, and the points of all together."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError
from hitchopt.storage.plain import Plain

Point = dict[str, Plain]
"""One value of every parameter, by key path."""

MAX_CASES = 1_000_000
"""Largest number of cases of one study; more are a typing error."""

_PART = re.compile(r"([A-Za-z_][A-Za-z_0-9]*)|\[([0-9]{1,6})\]")


@dataclass(frozen=True)
class Listed:
    """A parameter that takes given values, each with every value of the others.

    Parameters
    ----------
    key: path of a key, such as ``team.tension`` or ``mission[0].form.altitude``.
    values: the values.
    """

    key: str
    values: tuple[Plain, ...]


@dataclass(frozen=True)
class Drawn:
    """A parameter that is drawn from a range, one value a sample.

    Parameters
    ----------
    key: path of a key.
    low, high: ends of the range.
    log: whether the logarithm is distributed evenly, not the value.
    quasi: whether samples are those of a Halton sequence (Owen 2017), which fill the range evenly.
    """

    key: str
    low: float
    high: float
    log: bool = False
    quasi: bool = False

    def at(self, shares: NDArray[np.float64]) -> list[float]:
        """Return the values at shares (samples,) of the range, 0 to 1."""
        if self.log:
            return list(np.exp(np.interp(shares, [0.0, 1.0], np.log([self.low, self.high]))))
        return list(np.interp(shares, [0.0, 1.0], [self.low, self.high]))


Parameter = Listed | Drawn


def points(parameters: Sequence[Parameter], samples: int, seed: int) -> list[Point]:
    """Return every combination of the listed values, with every sample of the drawn ones.

    Parameters
    ----------
    parameters: in the study's order, which is that of the points: the last listed one changes
        first, samples before it.
    samples: number of samples of the drawn ones; 1 counts where none is drawn.
    seed: of the samples.

    Raises
    ------
    InputError: more than MAX_CASES points.
    """
    listed = [p for p in parameters if isinstance(p, Listed)]
    drawn = [p for p in parameters if isinstance(p, Drawn)]
    count = int(np.prod([len(p.values) for p in listed])) * (samples if drawn else 1)
    if count > MAX_CASES:
        raise InputError("parameters", count, f"at most {MAX_CASES} combinations", "take fewer")
    samples_of = _samples(drawn, samples if drawn else 1, seed)
    found: list[Point] = []
    for values in itertools.product(*(p.values for p in listed)):
        chosen = dict(zip((p.key for p in listed), values, strict=True))
        for sample in samples_of:
            whole = chosen | sample
            found.append({p.key: whole[p.key] for p in parameters})
    return found


def _samples(drawn: Sequence[Drawn], count: int, seed: int) -> list[dict[str, Plain]]:
    """Return the values of every sample, by key."""
    from scipy.stats import qmc

    quasi = [p for p in drawn if p.quasi]
    even = qmc.Halton(max(len(quasi), 1), scramble=True, seed=np.random.default_rng(seed))
    shares = dict(zip((p.key for p in quasi), even.random(count).T, strict=False))
    chance = np.random.default_rng([seed, 1])
    for p in drawn:
        if not p.quasi:
            shares[p.key] = chance.random(count)
    columns = {p.key: p.at(shares[p.key]) for p in drawn}
    return [{key: float(values[i]) for key, values in columns.items()} for i in range(count)]


def key_parts(key: str) -> list[str | int]:
    """Return the parts of a key path: ``mission[0].hold`` is ``["mission", 0, "hold"]``.

    Raises
    ------
    InputError: no key path.
    """
    parts: list[str | int] = []
    for word in key.split("."):
        found = _PART.findall(word)
        if not found or "".join(name or f"[{index}]" for name, index in found) != word:
            bound = "a key path such as team.tension or mission[0].form.altitude"
            raise InputError("parameters", key, bound, "names with dots, places in brackets")
        parts += [name or int(index) for name, index in found]
    return parts


def with_values(base: Mapping[str, Plain], point: Point) -> dict[str, Plain]:
    """Return a copy of a mapping in which the keys have the values of a point.

    Mappings that are missing on the way are made; lists are as long as they are.

    Raises
    ------
    InputError: a path that leads through a value, or past the end of a list.
    """
    made: dict[str, Plain] = deepcopy(dict(base))
    for key, value in point.items():
        _set(made, key, value)
    return made


def _set(mapping: dict[str, Plain], key: str, value: Plain) -> None:
    *path, last = key_parts(key)
    inner: Plain = mapping
    for i, part in enumerate(path):
        if isinstance(inner, dict) and isinstance(part, str):
            following = [*path, last][i + 1]
            inner = inner.setdefault(part, {} if isinstance(following, str) else [])
        else:
            inner = _entry(inner, part, key)
    if isinstance(inner, dict) and isinstance(last, str):
        inner[last] = deepcopy(value)
    else:
        _entry(inner, last, key)
        if isinstance(inner, list) and isinstance(last, int):  # or an error has been raised
            inner[last] = deepcopy(value)


def _entry(inner: Plain, part: str | int, key: str) -> Plain:
    if isinstance(inner, list) and isinstance(part, int):
        if part < len(inner):
            return inner[part]
        bound, remedy = f"below {len(inner)}, the list's length", "count from 0"
        raise InputError(f"parameters.{key}", f"[{part}]", bound, remedy)
    kind = "a mapping" if isinstance(inner, dict) else "a value"
    kind = "a list" if isinstance(inner, list) else kind
    bound = "a place in a list, in brackets" if isinstance(inner, list) else "the name of a key"
    raise InputError(f"parameters.{key}", part, bound, f"what is there is {kind}")
