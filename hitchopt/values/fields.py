"""Fields that are declared once: kinds of values, keys of files, and records read from mappings.

A field of a record is annotated with a ``Key``: a kind of value and a sentence. From it follow the
check of what Python users give, the keys of files with their messages, the JSON Schema, docstrings
and the tables of the documentation::

    speed: Annotated[float, Key(SPEED, "Largest speed of every drone")] = 1.0

Angles are in radians in Python and in degrees in files, under names that end in ``_deg``.
"""

from __future__ import annotations

import functools
import inspect
import json
import math
import re
import textwrap
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from typing import Any, ParamSpec, TypeVar, get_type_hints

import numpy as np

from hitchopt.errors import FileError, InputError, JointInputError, UnitWarning, one_or_all
from hitchopt.values import (
    EACH,
    FLAG,
    MAPPING,
    MAX_COORDINATE,
    ONE,
    WORD,
    Array,
    closest_word,
    finite,
    flag,
    form_of,
    misfit,
    text,
    whole,
)

T = TypeVar("T")
P = ParamSpec("P")
Schema = dict[str, Any]

EMPTY = inspect.Parameter.empty
"""Default of a field that has none."""


@dataclass(frozen=True, eq=False)
class Kind:
    """A kind of value.

    Attributes
    ----------
    forms: of its values, as ``form_of`` calls them.
    check: gives the value that records store for one under a key, or raises InputError.
    schema: the JSON Schema, in which kinds stand for their own; or a function that adds one to some
        definitions and returns the reference.
    unit: of its numbers.
    degrees: the same angles in degrees; None for other kinds.
    """

    forms: tuple[str, ...]
    check: Callable[[str, Any], Any]
    schema: Any
    unit: str = ""
    degrees: Kind | None = None


@dataclass(frozen=True, eq=False)
class Key:
    """A field as a file has it.

    Attributes
    ----------
    kind, text: of its values; what it means, without the unit.
    example: a value that may be written.
    name: in files, where it is not that of the field.
    default: EMPTY for none; known of keys that ``keys_of`` returns.
    """

    kind: Kind
    text: str
    example: Any = None
    name: str = ""
    default: Any = EMPTY

    @property
    def file_kind(self) -> Kind:
        """The kind of its values in files."""
        return self.kind.degrees or self.kind

    def from_file(self, key: str, value: Any) -> Any:
        """Return the field's value for one in a file, or raise InputError; also what it means."""
        try:
            checked = self.file_kind.check(key, value)
        except InputError as error:
            if error.key != key or form_of(value) in self.file_kind.forms:
                raise
            more = f"{error.remedy} ({self.described(self.file_kind)})"
            raise InputError(key, value, error.bound, more) from None
        if self.kind.degrees is None or isinstance(checked, str | None):
            return checked
        return np.radians(checked) if np.ndim(checked) else math.radians(checked)

    def to_file(self, value: Any) -> Any:
        """Return a field's number as files have it."""
        turned = self.kind.degrees is not None and isinstance(value, float)
        return round(math.degrees(value), 9) if turned else value

    def described(self, kind: Kind) -> str:
        """Return the text with the unit of a kind."""
        words, stop, rest = self.text.partition(";")
        return f"{words} [{kind.unit}]{stop}{rest}" if kind.unit else self.text


_KEYS: dict[Any, dict[str, Key]] = {}


def keys_of(record: type[Any]) -> dict[str, Key]:
    """Return the keys of a record by the names of its fields, with names in files and defaults."""
    if record not in _KEYS:
        _KEYS[record] = dict(_declared(record))
    return _KEYS[record]


def _declared(record: type[Any]) -> Iterator[tuple[str, Key]]:
    hints = get_type_hints(record, include_extras=True)
    arguments = inspect.signature(record).parameters
    for field in fields(record):
        annotations = getattr(hints[field.name], "__metadata__", ())
        for key in (each for each in annotations if isinstance(each, Key)):
            default = arguments[field.name].default if field.name in arguments else field.default
            if field.default_factory is not MISSING:
                default = field.default_factory()
            name = key.name or field.name + "_deg" * (key.kind.degrees is not None)
            yield field.name, replace(key, name=name, default=default)


def store(record: object, **values: Any) -> None:
    """Set fields of a frozen record, those with a key to the results of their checks.

    None is accepted if it is the field's default.
    """
    keys = keys_of(type(record))
    for name, value in values.items():
        key = keys.get(name)
        checked = key is not None and not (value is None and key.default is None)
        stored = key.kind.check(name, value) if key and checked else value
        object.__setattr__(record, name, stored)


class InDegrees:
    """Argument of a record for an angle in degrees; on records the stored one in degrees.

    ``dataclasses.replace`` passes what it reads of a record: ``store_with_degrees`` ignores that.
    """

    def __init__(self, name: str) -> None:
        self.name = name

    def __get__(self, record: object | None, owner: type) -> float | None:
        angle = None if record is None else getattr(record, self.name)
        return None if angle is None else _Read(math.degrees(angle))

    def __repr__(self) -> str:
        return "None"  # in signatures: it is the default


class _Read(float):
    """An angle in degrees that was read of a record."""


def store_with_degrees(record: Any, **degrees: float | None) -> None:
    """Check and set a record's fields as ``store``, some angles of which are given in degrees.

    Raises InputError where one is given in radians too.
    """
    keys = keys_of(type(record))
    given = {
        name: each
        for name, each in degrees.items()
        if not isinstance(each, _Read | InDegrees | None)
    }
    store(record, **{name: each for name, each in vars(record).items() if name not in given})
    for name, angle in given.items():
        key = keys[name]
        if getattr(record, name) != key.default:
            bound = f"left out where {name} is given"
            raise InputError(key.name, angle, bound, "give one of the two")
        radians = math.radians(key.file_kind.check(key.name, angle))
        object.__setattr__(record, name, radians)


def refuse_unknown(name: str, known: Sequence[str], given: Iterable[str]) -> None:
    """Raise TypeError for a keyword that a function does not have, with the one that was meant."""
    for each in given:
        if each not in known:
            raise TypeError(f"{name}() has no argument {each!r}; {closest_word(each, known)}")


def suggesting(function: Callable[P, T], name: str = "") -> Callable[P, T]:
    """Return a function that says which keyword was meant, under a name or its own."""
    known = [*inspect.signature(function).parameters]

    @functools.wraps(function)
    def suggested(*args: P.args, **kwargs: P.kwargs) -> T:
        refuse_unknown(name or function.__qualname__, known, kwargs)
        return function(*args, **kwargs)

    return suggested


def documented(record: type[T]) -> type[T]:
    """Add the list of parameters to a record's docstring; suggest keywords for unknown ones."""
    record.__init__ = suggesting(record.__init__, record.__name__)  # type: ignore[method-assign]
    words, raises, errors = inspect.cleandoc(record.__doc__ or "").partition("Raises\n------")
    listed = f"{words.rstrip()}\n\nParameters\n----------\n{parameters(record)}"
    record.__doc__ = f"{listed}\n\n{raises}{errors}" if raises else listed
    return record


def parameters(record: type[Any], without: str = "") -> str:
    """Return the fields of a record as a docstring lists them."""
    lines = []
    for name, key in keys_of(record).items():
        words = key.described(key.kind).replace("null:", "None:")
        line = f"{name}: {words[0].lower()}{words[1:]}."
        lines += [textwrap.fill(line, 92, subsequent_indent="    ")] * (name != without)
    return "\n".join(lines)


# Records from mappings.


class Missing:
    """Stands for the value of a key that is not there."""

    def __repr__(self) -> str:
        return "(missing)"


def values_of(
    record: type[Any],
    key: str,
    data: Any,
    without: Collection[str] = (),
    remedies: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Return the arguments of a record that a mapping holds; all faults are raised at once.

    Keys ``without`` are unknown; ``remedies`` are those of some unknown or missing keys.
    """
    if not isinstance(data, Mapping):
        raise misfit(key or "problem", data, MAPPING)
    fields_by_key = {
        each.name: name for name, each in keys_of(record).items() if each.name not in without
    }

    meant = {name: closest_word(name, [*fields_by_key]) for name in data.keys() - fields_by_key}
    own = meant | dict(remedies or {})

    def argument(name: str) -> tuple[str, Any]:
        """Return the name and value of a constructor's argument; no name for a default."""
        path, value = joined(key, name), data.get(name, Missing())
        if name not in fields_by_key:
            raise InputError(path, value, "a known key", own[name])
        field = fields_by_key[name]
        declared = keys_of(record)[field]
        misspelt = f"did you mean {name}?" in meant.values()
        if isinstance(value, Missing) and (misspelt or declared.default is not EMPTY):
            return "", None
        if declared.default is EMPTY and (isinstance(value, Missing) or value in (None, [])):
            remedy = own.get(name, f"add {name}: {_written(declared.example)}")
            raise InputError(path, value, "given", remedy)
        if value is None and declared.default is None:
            return field, None
        return field, declared.from_file(path, value)

    arguments = dict(gathered(argument, dict.fromkeys((*data, *fields_by_key))))
    arguments.pop("", None)
    return arguments


def _written(example: Any) -> str:
    """Return an example as a file has it; of points, whose number depends, the first."""
    text = "…" if example is None else json.dumps(example).replace('"', "")
    return re.sub(r"(\[\[[^]]*\]), \[.*?\]\]", r"\1, …]", text)


def gathered(read: Callable[[Any], T], given: Iterable[Any]) -> list[T]:
    """Return what is read of each of some values; all faults are raised at once."""
    values, faults = list[T](), list[InputError]()
    for each in given:
        try:
            values.append(read(each))
        except InputError as error:
            faults += error.errors if isinstance(error, JointInputError) else [error]
    if faults:
        raise one_or_all(faults)
    return values


def joined(path: str, part: str | int) -> str:
    """Return the path of an entry as messages show it, such as ``mission[0].morph``.

    Keys that are no names are quoted, so that no control character reaches a terminal.
    """
    if isinstance(part, int):
        return f"{path}[{part}]"
    name = part if part.isidentifier() and part.isascii() else repr(part)
    name = name if len(name) <= 60 else f"{name[:57]}..."
    return f"{path}.{name}" if path else name


# The JSON Schema.


def plain_schema(schema: Any, definitions: dict[str, Schema]) -> Any:
    """Return a schema with those of its kinds; mappings of keys are added to the definitions."""
    if isinstance(schema, Kind):
        return plain_schema(schema.schema, definitions)
    if callable(schema):
        return schema(definitions)
    if isinstance(schema, list):
        return [plain_schema(each, definitions) for each in schema]
    if isinstance(schema, dict):
        return {key: plain_schema(each, definitions) for key, each in schema.items()}
    return schema


def record_schema(
    record: type[Any], definitions: dict[str, Schema], without: Collection[str] = ()
) -> Schema:
    """Add the schema of a record's keys to definitions; return the reference to it."""
    properties, required = dict[str, Any](), list[str]()
    for key in keys_of(record).values():
        if key.name in without:
            continue
        entry = plain_schema(key.file_kind, definitions)
        if key.default is None:
            entry = {"anyOf": [entry, {"type": "null"}]}
        if isinstance(key.default, str | int | float):
            entry = entry | {"default": key.to_file(key.default)}
        properties[key.name] = entry | {"description": key.described(key.file_kind)}
        required += [key.name] * (key.default is EMPTY)
    more = {"required": required} if required else {}
    name = f"Swarm{record.__name__}" if without else record.__name__
    return defined(name, record.__doc__, properties, definitions, more)


def defined(
    name: str, words: str | None, properties: Schema, definitions: dict[str, Schema], more: Schema
) -> Schema:
    """Add the schema of a mapping of known keys to definitions; return the reference to it.

    The first of the lines of ``words`` describes it.
    """
    summary = inspect.cleandoc(words or "").partition("\n")[0]
    closed = {"type": "object", "properties": properties, "additionalProperties": False}
    definitions[name] = {"description": summary, **closed, **more}
    return {"$ref": f"#/$defs/{name}"}


# Kinds of values; those of physical quantities are in ``units``.


def whole_number(least: int, most: int) -> Kind:
    """Return the kind of whole numbers in a range."""
    schema = {"type": "integer", "minimum": least, "maximum": most}
    return Kind((ONE,), lambda key, value: whole(key, value, least, most), schema)


FLAGS = Kind((FLAG,), flag, {"type": "boolean"})
"""True or false."""

ANYTHING = Kind((ONE, EACH, WORD, FLAG, MAPPING), lambda _, value: value, {})
"""Any plain data."""


def words(*plain: str | bool, **values: Any) -> Kind:
    """Return the kind of some words (or flags); for those of ``values`` these are stored."""
    stored: dict[Any, Any] = {word: word for word in plain} | values
    known = [str(word).lower() for word in stored]

    def check(key: str, value: Any) -> Any:
        if isinstance(value, str | bool) and value in stored:
            return stored[value]
        if values and type(value) is int and value in values.values():
            return value
        bound = " or ".join(known) if len(known) < 3 else f"one of {', '.join(known)}"
        otherwise = f"write {known[0]}"
        remedy = closest_word(value, known, otherwise) if isinstance(value, str) else otherwise
        raise InputError(key, value, bound, remedy)

    return Kind(tuple(dict.fromkeys(map(form_of, stored))), check, {"enum": list(stored)})


def texts(most: int, least: int = 0, pattern: str = ".*", bound: str = "") -> Kind:
    """Return the kind of texts of a length, all of whose characters match a pattern."""

    def check(key: str, value: Any) -> str:
        given = text(key, value)
        if not least <= len(given) <= most:
            size = f"from {least} to {most}" if least else f"at most {most}"
            raise InputError(key, given, f"{size} characters long", "shorten it")
        if not re.fullmatch(pattern, given, re.DOTALL):
            raise InputError(key, given, bound, "use another name")
        return given

    schema: Schema = {"type": "string", "minLength": least, "maxLength": most}
    return Kind((WORD,), check, schema | ({"pattern": f"^{pattern}$"} if bound else {}))


def points(
    shape: tuple[int | None, ...],
    entry: str,
    least: int = 1,
    most: int | None = None,
    passed: type | tuple[()] = (),
) -> Kind:
    """Return the kind of arrays of finite numbers [m], in files lists within lists.

    Parameters
    ----------
    shape: None for a free number of entries, from ``least`` to ``most``.
    entry: names of one point's numbers, such as ``x, y``.
    passed: type of values that are such points already.
    """

    def numbers(key: str, value: Any, shape: tuple[int | None, ...]) -> Any:
        if not shape:
            return finite(key, value)
        count, point = shape[0], f"a point [{entry}]"
        bound = f"a list of {count or f'at least {least}'} points [{entry}]"
        bound = point if len(shape) == 1 else bound
        value = value.tolist() if isinstance(value, np.ndarray) else value
        if not isinstance(value, list | tuple):
            raise misfit(key, value, bound)
        if count is not None and len(value) != count:
            raise InputError(key, value, bound, f"give {count} entries")
        if count is None and len(value) < least:
            raise InputError(key, value, bound, "make it longer")
        if count is None and most is not None and len(value) > most:
            raise InputError(key, f"{len(value)} points", f"at most {most} points", "shorten it")
        return [numbers(f"{key}[{i}]", each, shape[1:]) for i, each in enumerate(value)]

    def check(key: str, value: Any) -> Any:
        if isinstance(value, passed):
            return value
        array: Array = np.array(numbers(key, value, shape), dtype=np.float64)
        near = np.all(np.abs(array) <= MAX_COORDINATE, axis=-1)
        if not np.all(near):
            k = int(np.argmin(near))
            where, point = (f"{key}[{k}]", array[k]) if array.ndim > 1 else (key, array)
            bound = f"finite and within ±{MAX_COORDINATE:g} m"
            raise InputError(where, point.tolist(), bound, "check the point's coordinates")
        array.setflags(write=False)
        return array

    schema: Schema = {"type": "number", "minimum": -MAX_COORDINATE, "maximum": MAX_COORDINATE}
    for count in reversed(shape):
        size = {"minItems": least if count is None else count}
        end = most if count is None else count
        size |= {} if end is None else {"maxItems": end}
        schema = {"type": "array", "items": schema, **size}
    return Kind((EACH,), check, schema)


def listed(kind: Kind, least: int = 0, most: int | None = None) -> Kind:
    """Return the kind of lists of values of a kind."""

    def check(key: str, value: Any) -> list[Any]:
        if not isinstance(value, list | tuple | np.ndarray):
            raise misfit(key, value, EACH)
        if len(value) < least:
            bound = f"a list of at least {least} entries"
            raise InputError(key, value, bound, "make it longer")
        if most is not None and len(value) > most:
            bound = f"a list of at most {most} entries"
            raise InputError(key, f"{len(value)} entries", bound, "shorten it")
        return gathered(lambda i: kind.check(f"{key}[{i}]", value[i]), range(len(value)))

    size = {"minItems": least} | ({} if most is None else {"maxItems": most})
    degrees = kind.degrees and listed(kind.degrees, least, most)
    return Kind((EACH,), check, {"type": "array", "items": kind, **size}, kind.unit, degrees)


def either(*kinds: Kind) -> Kind:
    """Return the kind of values of several kinds, of which each has other forms."""
    forms = {form: kind for kind in reversed(kinds) for form in kind.forms}

    def check(key: str, value: Any) -> Any:
        if (form := form_of(value)) not in forms:
            raise misfit(key, value, *dict.fromkeys(form for kind in kinds for form in kind.forms))
        return forms[form].check(key, value)

    degrees = None
    if any(kind.degrees for kind in kinds):
        degrees = either(*(kind.degrees or kind for kind in kinds))
    unit = next((kind.unit for kind in kinds if kind.unit), "")
    return Kind(tuple(forms), check, {"oneOf": list(kinds)}, unit, degrees)


def one_or_each(kind: Kind, least: int, most: int) -> Kind:
    """Return the kind of one value for all, or a list of one per item."""
    return either(kind, listed(kind, least, most))


def mapping_of(
    record: type[T], build: Callable[[T], Any] | None = None, without: Collection[str] = ()
) -> Kind:
    """Return the kind of a record, in files a mapping of its keys.

    ``build`` makes the value of a record that only holds keys; keys ``without`` are unknown.
    """

    def check(key: str, value: Any) -> Any:
        if isinstance(value, record):
            return value
        arguments = values_of(record, key, value, without)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UnitWarning)  # of keys they have been issued
                made = record(**arguments)
            return made if build is None else build(made)
        except InputError as error:
            raise error.within(key) from None
        except FileError as error:
            raise InputError(key, value, "of files that can be read", str(error)) from None

    return Kind((MAPPING,), check, lambda definitions: record_schema(record, definitions, without))


def named(kind: Kind, names: Kind, most: int | None = None) -> Kind:
    """Return the kind of values of a kind by their names."""

    def check(key: str, value: Any) -> dict[str, Any]:
        if not isinstance(value, Mapping):
            raise misfit(key, value, MAPPING)
        if most is not None and len(value) > most:
            raise InputError(key, f"{len(value)} entries", f"at most {most}", "leave some out")

        def entry(name: str) -> tuple[str, Any]:
            path = joined(key, name)
            return names.check(path, name), kind.check(path, value[name])

        return dict(gathered(entry, value))

    schema = {"type": "object", "additionalProperties": kind, "propertyNames": names}
    return Kind((MAPPING,), check, schema | ({} if most is None else {"maxProperties": most}))


def by_key(kinds: Mapping[str, Kind]) -> Kind:
    """Return the kind of mappings that a key tells apart: the first that is there, else the first.

    Values that are no mappings are of the first kind.
    """
    first = next(iter(kinds))

    def check(key: str, value: Any) -> Any:
        there = (name for name in kinds if isinstance(value, Mapping) and name in value)
        return kinds[next(there, first)].check(key, value)

    return Kind((MAPPING,), check, {"anyOf": list(kinds.values())})


def one_key(
    name: str,
    summary: str,
    records: Mapping[str, type[Any]],
    example: str,
    passed: tuple[type[Any], ...] = (),
) -> Kind:
    """Return the kind of mappings with one key, which says of what record its value is.

    Such records, and those of the types ``passed``, are values already.
    """
    kinds = {key: mapping_of(record) for key, record in records.items()}
    types, what = (*records.values(), *passed), name.removeprefix("Team").lower()

    def written(kind: str) -> str:
        """Return an example of a kind with the keys that it needs."""
        keys = keys_of(records[kind]).values()
        return f"{kind}: {_written({k.name: k.example for k in keys if k.default is EMPTY})}"

    def check(key: str, value: Any) -> Any:
        if isinstance(value, types):
            return value
        if isinstance(value, str) and value in kinds:
            raise InputError(key, value, MAPPING, f"write {written(value)}")
        if not isinstance(value, Mapping):
            raise misfit(key, value, MAPPING)
        if len(value) != 1:
            bound = f"a mapping with exactly one of the keys {', '.join(kinds)}"
            raise InputError(key, value, bound, f"write {example}")
        ((kind, given),) = value.items()
        if kind not in kinds:
            meant = closest_word(kind, list(kinds))
            for each in kinds:
                meant = meant.replace(f"mean {each}?", f"mean {written(each)}?")
            raise InputError(joined(key, kind), given, f"a known {what}", meant)
        if form_of(given) != MAPPING:
            raise InputError(joined(key, kind), given, MAPPING, f"write {written(kind)}")
        return kinds[kind].check(joined(key, kind), given)

    def schema(definitions: dict[str, Schema]) -> Schema:
        one = {"minProperties": 1, "maxProperties": 1}
        return defined(name, summary, plain_schema(kinds, definitions), definitions, one)

    return Kind((MAPPING,), check, schema)
