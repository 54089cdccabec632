"""Declarations of fields: kinds of values, keys of files, and records read from mappings.

A field of a record is annotated with a ``Key``: a kind of value and a sentence. The key determines
the check of Python arguments, the keys of files with their messages, the JSON Schema, docstrings
and the tables of the documentation::

    speed: Annotated[float, Key(SPEED, "Largest speed of every drone")] = 1.0

Angles are in radians in Python. In files they are in degrees, and their names end in ``_deg``.
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
from dataclasses import MISSING, InitVar, dataclass, fields, replace
from types import UnionType
from typing import Any, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import (
    KNOWN,
    MAX_LISTED,
    UNKNOWN_KEY,
    Circumstance,
    FileError,
    InputError,
    JointInputError,
    Missing,
    UnitWarning,
    joint_error,
)
from hitchopt.retired import gone, refuse_retired
from hitchopt.values import (
    FLAG,
    LIST,
    MAPPING,
    MAX_COORDINATE,
    SCALAR,
    WORD,
    ByValue,
    Points,
    alternatives,
    bounded_points,
    closest_word,
    finite,
    flag,
    form_error,
    form_of,
    integer,
    line,
    plain,
    text,
)

T = TypeVar("T")
P = ParamSpec("P")
Schema = dict[str, Any]

EMPTY = inspect.Parameter.empty  # Default of a field without one


@dataclass(frozen=True, eq=False)
class Kind:
    """A kind of value."""

    forms: tuple[str, ...]  # forms of its values, as returned by ``form_of``
    # function of key and value that returns the value to store, or raises InputError
    check: Callable[[str, Any], Any]
    # JSON Schema, in which kinds stand for their schemas; or a function that adds a schema to
    # definitions and returns a reference to it
    schema: Any
    unit: str = ""  # unit of its numbers
    degrees: Kind | None = None  # the kind with angles in degrees; None for other kinds
    accepted: tuple[str, ...] = ()  # what messages call its values; by default their forms

    def __post_init__(self) -> None:
        object.__setattr__(self, "accepted", self.accepted or self.forms)

    @property
    def bound(self) -> str:
        """What values are, in the message on what is none."""
        return alternatives(self.accepted)


@dataclass(frozen=True, eq=False)
class Key:
    """A field and its key in files."""

    kind: Kind  # kind of its values
    text: str  # meaning, without the unit
    example: Any = None  # example of a value in files
    name: str = ""  # key in files, if it differs from the field's name
    default: Any = EMPTY  # default value; set by ``keys_of``, EMPTY without one
    null: bool = False  # whether None is a value of it; it always is as its default
    omitted: bool = False  # plan files omit its default: earlier ones do not have the key

    @property
    def file_kind(self) -> Kind:
        """Kind of its values in files."""
        return self.kind.degrees or self.kind

    @property
    def accepts_none(self) -> bool:
        """Return whether None is a value of it."""
        return self.null or self.default is None

    def check_given(self, kind: Kind, key: str, value: Any) -> None:
        """Raise InputError for None in place of a value of a kind that can be omitted."""
        if value is None and self.default is not EMPTY:
            raise InputError(key, None, kind.bound, "set a value, or omit it")

    def from_file(self, key: str, value: Any) -> Any:
        """Return the field's value for a value in a file; errors explain the key's meaning."""
        try:
            self.check_given(self.file_kind, key, value)
            checked = self.file_kind.check(key, value)
        except InputError as error:
            has_form = form_of(value) in self.file_kind.forms
            if error.key != key or (has_form and error.bound != self.file_kind.bound):
                raise
            remedy = f"{error.remedy} ({self.described(self.file_kind)})"
            raise InputError(key, value, error.bound, remedy) from None
        if self.kind.degrees is None or isinstance(checked, str | None):
            return checked
        return np.radians(checked) if np.ndim(checked) else math.radians(checked)

    def to_file(self, value: Any) -> Any:
        """Return a field's number in the unit of files."""
        is_angle = self.kind.degrees is not None and isinstance(value, float)
        return round(math.degrees(value), 9) if is_angle else value

    def described(self, kind: Kind) -> str:
        """Return the meaning with the unit of a kind."""
        meaning, separator, details = self.text.partition(";")
        return f"{meaning} [{kind.unit}]{separator}{details}" if kind.unit else self.text


_KEYS: dict[Any, dict[str, Key]] = {}


def keys_of(record: type[Any]) -> dict[str, Key]:
    """Return the keys of a record by field name, with names in files and defaults."""
    if record not in _KEYS:
        _KEYS[record] = dict(_declared_keys(record))
    return _KEYS[record]


def _declared_keys(record: type[Any]) -> Iterator[tuple[str, Key]]:
    hints = get_type_hints(record, include_extras=True)
    arguments = inspect.signature(record).parameters
    for field in fields(record):
        annotations = getattr(hints[field.name], "__metadata__", ())
        for key in (each for each in annotations if isinstance(each, Key)):
            default = field.default
            if default is MISSING and field.name in arguments:
                default = arguments[field.name].default
            if field.default_factory is not MISSING:
                default = field.default_factory()
            name = key.name or field.name + "_deg" * (key.kind.degrees is not None)
            yield field.name, replace(key, name=name, default=default)


def store(record: object, **values: Any) -> None:
    """Set fields of a frozen record; values of fields with a key are checked.

    None is accepted if it is the field's default, or a value of its key.
    """
    keys = keys_of(type(record))
    for name, value in values.items():
        key, stored = keys.get(name), value
        if key is not None and not (value is None and key.accepts_none):
            key.check_given(key.kind, name, value)
            stored = key.kind.check(name, value)
        object.__setattr__(record, name, stored)


class Record(ByValue):
    """A frozen record that checks its fields."""

    def __post_init__(self) -> None:
        store(self, **vars(self))


def store_degrees(record: object, **degrees: float | None) -> None:
    """Check and set angles of a frozen record that are given in degrees [°]; None for the others.

    Raises InputError for an angle in both radians and degrees.
    """
    keys = keys_of(type(record))
    for name, angle in degrees.items():
        if angle is None:
            continue
        key = keys[name]
        if getattr(record, name) != key.default:
            bound = f"omitted if {name} is given"
            raise InputError(key.name, angle, bound, "use only one of the two")
        radians = math.radians(key.file_kind.check(key.name, angle))
        object.__setattr__(record, name, radians)


def with_fields(record: T, **fields: Any) -> T:
    """Return a copy of a record with other values of some fields, which a computation has found.

    Values are checked without warnings: unchanged values were checked when the record was made.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnitWarning)
        copy: T = replace(record, **fields)  # type: ignore[type-var]
    return copy


def check_keywords(name: str, valid: Sequence[str], keywords: Iterable[str]) -> None:
    """Raise TypeError for a keyword that function ``name`` does not have; suggest a valid one."""
    stated = [word for word in valid if word != "self"]
    for each in keywords:
        if each not in valid:
            remedy = gone(f"{name.lower()}.{each}") or closest_word(each, stated)
            raise TypeError(f"{name}() has no argument {each!r}; {remedy}")


def suggest_keywords(function: Callable[P, T], name: str = "") -> Callable[P, T]:
    """Return the function with errors that suggest valid keywords, under ``name`` or its own."""
    valid = [*inspect.signature(function).parameters]

    @functools.wraps(function)
    def with_suggestion(*args: P.args, **kwargs: P.kwargs) -> T:
        check_keywords(name or function.__qualname__.removesuffix(".__init__"), valid, kwargs)
        return function(*args, **kwargs)

    return with_suggestion


def with_suggestions(record: type[T]) -> type[T]:
    """Let errors of a record's constructor suggest valid keywords."""
    record.__init__ = suggest_keywords(record.__init__, record.__name__)  # type: ignore[method-assign]
    return record


def documented(record: type[T]) -> type[T]:
    """Add the parameters to a record's docstring, and plain types to its signature.

    Errors suggest valid keywords.
    """
    plain = _plain_signature(record.__init__)
    with_suggestions(record)
    record.__init__.__signature__ = plain  # type: ignore[attr-defined]
    summary, raises, errors = inspect.cleandoc(record.__doc__ or "").partition("Raises\n------")
    docs = f"{summary.rstrip()}\n\nParameters\n----------\n{parameter_docs(record)}"
    record.__doc__ = f"{docs}\n\n{raises}{errors}" if raises else docs
    return record


def _plain_signature(function: Callable[..., Any]) -> inspect.Signature:
    """Return the signature of a function with types in words, without keys and names of aliases."""
    hints = get_type_hints(function)
    signature = inspect.signature(function)
    parameters = [
        each.replace(annotation=_type_in_words(hints[name])) if name in hints else each
        for name, each in signature.parameters.items()
    ]
    return signature.replace(parameters=parameters, return_annotation=EMPTY)


def _type_in_words(hint: Any) -> str:
    """Return a type without the names of modules; all that numpy makes an array of is ArrayLike."""
    if isinstance(hint, InitVar):
        hint = hint.type
    parts = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    members = {*get_args(ArrayLike)} or {ArrayLike}  # it is one part where numpy has an alias
    if members <= {*parts}:
        parts = (ArrayLike, *(part for part in parts if part not in get_args(Points)))
    words = ["ArrayLike" if each is ArrayLike else inspect.formatannotation(each) for each in parts]
    return re.sub(r"\b(?:\w+\.)+(?=\w)", "", " | ".join(words)).replace("NoneType", "None")


def parameter_docs(record: type[Any]) -> str:
    """Return the fields of a record in the format of docstrings."""
    lines = []
    for name, key in keys_of(record).items():
        text = key.described(key.kind).replace("null:", "None:")
        line = f"{name}: {text[0].lower()}{text[1:]}."
        lines.append(textwrap.fill(line, 92, subsequent_indent="    "))
    return "\n".join(lines)


# Records from mappings.


def arguments_from(
    keys: Mapping[str, Key],
    key: str,
    data: Any,
    exclude: Collection[str] = (),
    remedies: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Return the values of ``keys`` by field from a mapping; all errors are raised together.

    Keys in ``exclude`` are unknown; ``remedies`` apply to some unknown or missing keys.
    """
    if not isinstance(data, Mapping):
        raise form_error(key or "problem", data, MAPPING)
    fields_by_key = {each.name: name for name, each in keys.items() if each.name not in exclude}
    unknown = [name for name in data if name not in fields_by_key]
    if len(unknown) > MAX_LISTED:
        bound = f"a mapping of {', '.join([*fields_by_key][:MAX_LISTED])}"
        raise InputError(key or "problem", f"{len(unknown)} unknown keys", bound, "remove them")
    guesses = {name: closest_word(name, [*fields_by_key]) for name in unknown}
    keys_by_field = {field: name for name, field in fields_by_key.items()}
    for name in keys_by_field.keys() & guesses.keys():  # such as tilt for tilt_deg
        guesses[name] = f"did you mean {keys_by_field[name]}?"
    for name in unknown:
        if ":" in name and data[name] is None:
            guesses[name] = f"write a blank after the colon: {name.replace(':', ': ', 1)}"
    remedies = guesses | dict(remedies or {})

    def argument(name: str) -> tuple[str, Any]:
        """Return the name and value of a constructor's argument; no name for a default."""
        path, value = join_key(key, name), data.get(name, Missing())
        if name not in fields_by_key:
            refuse_retired(path)
            raise InputError(path, value, UNKNOWN_KEY, remedies[name])
        field = fields_by_key[name]
        declared = keys[field]
        misspelt = f"did you mean {name}?" in guesses.values()
        if isinstance(value, Missing) and (misspelt or declared.default is not EMPTY):
            return "", None
        if declared.default is EMPTY and (isinstance(value, Missing) or value in (None, [])):
            remedy = remedies.get(name, f"add {name}: {_as_yaml(declared.example)}")
            raise InputError(path, value, "given", remedy)
        if value is None and declared.accepts_none:
            return field, None
        return field, declared.from_file(path, value)

    arguments = dict(collect(argument, dict.fromkeys((*data, *fields_by_key))))
    arguments.pop("", None)
    return arguments


def _as_yaml(example: Any) -> str:
    """Return an example in YAML; a list of points, whose number varies, is cut after the first."""
    text = "…" if example is None else json.dumps(example).replace('"', "")
    return re.sub(r"(\[\[[^]]*\]), \[.*?\]\]", r"\1, …]", text)


def collect(function: Callable[[Any], T], items: Iterable[Any]) -> list[T]:
    """Return the results of a function for all items; all errors are raised together."""
    results, errors = list[T](), list[InputError]()
    for item in items:
        try:
            results.append(function(item))
        except InputError as error:
            errors += error.errors if isinstance(error, JointInputError) else [error]
    if errors:
        raise joint_error(errors)
    return results


def join_key(path: str, part: str | int) -> str:
    """Return the path of an entry in the format of messages, such as ``mission[0].morph``.

    Keys that are not identifiers are quoted, so that no control character reaches a terminal.
    """
    if isinstance(part, int):
        return f"{path}[{part}]"
    name = part if part.isidentifier() and part.isascii() else repr(part)
    name = name if len(name) <= 60 else f"{name[:57]}..."
    return f"{path}.{name}" if path else name


# The JSON Schema.


def resolved_schema(schema: Any, definitions: dict[str, Schema]) -> Any:
    """Return a schema with its kinds replaced by their schemas; add mappings to definitions."""
    if isinstance(schema, Kind):
        return resolved_schema(schema.schema, definitions)
    if callable(schema):
        return schema(definitions)
    if isinstance(schema, list):
        return [resolved_schema(each, definitions) for each in schema]
    if isinstance(schema, dict):
        return {key: resolved_schema(each, definitions) for key, each in schema.items()}
    return schema


def record_schema(
    record: type[Any], definitions: dict[str, Schema], exclude: Collection[str] = ()
) -> Schema:
    """Add the schema of a record's keys to definitions; return a reference to it."""
    name = f"Swarm{record.__name__}" if exclude else record.__name__
    keys = [key for key in keys_of(record).values() if key.name not in exclude]
    return keys_schema(name, record.__doc__, keys, definitions)


def keys_schema(
    name: str, doc: str | None, keys: Iterable[Key], definitions: dict[str, Schema]
) -> Schema:
    """Add the schema of a mapping with some keys to definitions; return a reference to it."""
    properties, required = dict[str, Any](), list[str]()
    for key in keys:
        entry = resolved_schema(key.file_kind, definitions)
        if key.accepts_none:
            entry = {"anyOf": [entry, {"type": "null"}]}
        if isinstance(key.default, str | int | float):
            entry = entry | {"default": key.to_file(key.default)}
        properties[key.name] = entry | {"description": key.described(key.file_kind)}
        required += [key.name] * (key.default is EMPTY)
    options = {"required": required} if required else {}
    return mapping_schema(name, doc, properties, definitions, options)


def mapping_schema(
    name: str, doc: str | None, properties: Schema, definitions: dict[str, Schema], options: Schema
) -> Schema:
    """Add the schema of a mapping of known keys to definitions; return a reference to it.

    The first line of ``doc`` is its description.
    """
    summary = inspect.cleandoc(doc or "").partition("\n")[0]
    closed = {"type": "object", "properties": properties, "additionalProperties": False}
    definitions[name] = {"description": summary, **closed, **options}
    return {"$ref": f"#/$defs/{name}"}


# Kinds of values; kinds of physical quantities are in ``units``.


def integers(minimum: int, maximum: int) -> Kind:
    """Return the kind of integers in a range."""
    schema = {"type": "integer", "minimum": minimum, "maximum": maximum}
    return Kind(
        (SCALAR,),
        lambda key, value: integer(key, value, minimum, maximum),
        schema,
        accepted=("an integer",),
    )


FLAGS = Kind((FLAG,), flag, {"type": "boolean"})  # True or false
ANYTHING = Kind((SCALAR, LIST, WORD, FLAG, MAPPING), lambda _, value: value, {})  # Any plain data


CHOOSE = "choose one of them"  # Remedy for a value other than the valid ones, if there are several


def words(*names: str | bool, **values: Any) -> Kind:
    """Return the kind of some words or flags; words in ``values`` are stored as their values."""
    value_of: dict[Any, Any] = {word: word for word in names} | values
    valid = [str(word).lower() for word in value_of]

    def check(key: str, value: Any) -> Any:
        value = plain(key, value)
        if isinstance(value, str | bool) and value in value_of:
            return value_of[value]
        if values and type(value) is int and value in values.values():
            return value
        fallback = f"write {valid[0]}" if len(valid) == 1 else CHOOSE
        remedy = closest_word(value, valid, fallback) if isinstance(value, str) else fallback
        raise InputError(key, value, alternatives(valid), remedy)

    forms = tuple(dict.fromkeys(map(form_of, value_of)))
    return Kind(forms, check, {"enum": list(value_of)}, accepted=tuple(valid))


def strings(max_length: int, min_length: int = 0, pattern: str = ".*", bound: str = "") -> Kind:
    """Return the kind of strings in a range of lengths that match a pattern."""

    def check(key: str, value: Any) -> str:
        string = text(key, value)
        if not min_length <= len(string) <= max_length:
            size = f"from {min_length} to" if min_length else "at most"
            raise InputError(key, string, f"{size} {max_length} characters long", "shorten it")
        if not re.fullmatch(pattern, string, re.DOTALL):
            raise InputError(key, string, bound, "use another name")
        return string

    schema: Schema = {"type": "string", "minLength": min_length, "maxLength": max_length}
    schema |= {"pattern": f"^{pattern}$"} if bound else {}
    return Kind((WORD,), check, schema, accepted=("a string",))


def titles(max_length: int) -> Kind:
    """Return the kind of text on one line, without control characters."""
    kind = strings(max_length)
    return replace(kind, check=lambda key, value: line(key, kind.check(key, value)))


def points(
    shape: tuple[int | None, ...],
    entry: str,
    min_length: int = 1,
    max_length: int | None = None,
    accepted: type | tuple[()] = (),
    largest: float = MAX_COORDINATE,
) -> Kind:
    """Return the kind of arrays of finite numbers [m]; in files they are nested lists.

    Parameters
    ----------
    shape: shape of arrays; None for a number of entries from ``min_length`` to ``max_length``.
    entry: names of one point's numbers, such as ``x, y``.
    accepted: type of other values that are accepted as they are.
    largest: largest coordinate [m].
    """

    def words_of(shape: tuple[int | None, ...]) -> str:
        """Return what messages call an array of a shape."""
        if len(shape) == 1:
            return f"a point [{entry}]"
        at_least = f"at least {min_length} " if min_length > 1 else ""
        return f"a list of {f'{shape[0]} ' if shape[0] else at_least}points [{entry}]"

    def numbers(key: str, value: Any, shape: tuple[int | None, ...]) -> Any:
        if not shape:
            return finite(key, value)
        count, bound = shape[0], words_of(shape)
        value = plain(key, value)
        value = value.tolist() if isinstance(value, np.ndarray) else value
        if not isinstance(value, list | tuple):
            raise form_error(key, value, bound)
        if count is not None and len(value) != count:
            raise InputError(key, value, bound, f"specify {count} entries")
        if count is None and len(value) < min_length:
            raise InputError(key, value, bound, "make it longer")
        if count is None and max_length is not None and len(value) > max_length:
            bound = f"at most {max_length} points"
            counts = Circumstance(f"{len(value)} points, more than {max_length}")
            raise InputError(key, counts, bound, "shorten it")
        return [numbers(f"{key}[{i}]", each, shape[1:]) for i, each in enumerate(value)]

    def check(key: str, value: Any) -> Any:
        if isinstance(value, accepted):
            return value
        return bounded_points(key, np.array(numbers(key, value, shape), dtype=np.float64), largest)

    schema: Schema = {"type": "number", "minimum": -largest, "maximum": largest}
    for count in reversed(shape):
        lowest, highest = (min_length, max_length) if count is None else (count, count)
        size = {"minItems": lowest} | ({} if highest is None else {"maxItems": highest})
        schema = {"type": "array", "items": schema, **size}
    return Kind((LIST,), check, schema, accepted=(words_of(shape),))


def list_of(kind: Kind, min_length: int = 0, max_length: int | None = None) -> Kind:
    """Return the kind of lists of values of a kind."""

    def check(key: str, value: Any) -> list[Any]:
        value = plain(key, value)
        if not isinstance(value, list | tuple | np.ndarray):
            raise form_error(key, value, LIST)
        if len(value) < min_length:
            fewest = "one entry" if min_length == 1 else f"{min_length} entries"
            raise InputError(key, value, f"a list of at least {fewest}", "make it longer")
        if max_length is not None and len(value) > max_length:
            bound = f"a list of at most {max_length} entries"
            raise InputError(key, f"{len(value)} entries", bound, "shorten it")
        return collect(lambda i: kind.check(f"{key}[{i}]", value[i]), range(len(value)))

    size = {"minItems": min_length} | ({} if max_length is None else {"maxItems": max_length})
    degrees = kind.degrees and list_of(kind.degrees, min_length, max_length)
    return Kind((LIST,), check, {"type": "array", "items": kind, **size}, kind.unit, degrees)


def either(*kinds: Kind) -> Kind:
    """Return the union of kinds whose forms differ."""
    forms = {form: kind for kind in reversed(kinds) for form in kind.forms}
    accepted = tuple(dict.fromkeys(words for kind in kinds for words in kind.accepted))

    def check(key: str, value: Any) -> Any:
        value = plain(key, value)
        kind = forms.get(form_of(value))
        if kind is None:
            raise form_error(key, value, *accepted)
        try:
            return kind.check(key, value)
        except InputError as error:
            if (error.key, error.bound) != (key, kind.bound):
                raise
            remedy = closest_word(value, accepted, CHOOSE) if isinstance(value, str) else CHOOSE
            raise InputError(key, value, alternatives(accepted), remedy) from None

    degrees = None
    if any(kind.degrees for kind in kinds):
        degrees = either(*(kind.degrees or kind for kind in kinds))
    unit = next((kind.unit for kind in kinds if kind.unit), "")
    return Kind(tuple(forms), check, {"oneOf": list(kinds)}, unit, degrees, accepted)


def one_or_each(kind: Kind, min_length: int, max_length: int) -> Kind:
    """Return the kind of one value for all items, or a list of one per item."""
    return either(kind, list_of(kind, min_length, max_length))


def mapping_of(
    record: type[T],
    build: Callable[[T], Any] | None = None,
    exclude: Collection[str] = (),
) -> Kind:
    """Return the kind of a record; in files it is a mapping of its keys.

    ``build`` returns the value for a record that only holds keys; keys in ``exclude`` are unknown.
    """

    def check(key: str, value: Any) -> Any:
        if isinstance(value, record):
            return value
        arguments = arguments_from(keys_of(record), key, value, exclude)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UnitWarning)  # already issued for the keys
                instance = record(**arguments)
                return instance if build is None else build(instance)
        except InputError as error:
            raise error.within(key) from None
        except FileError as error:
            unread = Circumstance("a file cannot be read")
            raise InputError(key, unread, "of files that can be read", str(error)) from None

    return Kind((MAPPING,), check, lambda definitions: record_schema(record, definitions, exclude))


def dict_of(kind: Kind, names: Kind, max_length: int | None = None) -> Kind:
    """Return the kind of mappings of names to values of a kind."""

    def check(key: str, value: Any) -> dict[str, Any]:
        if not isinstance(value, Mapping):
            raise form_error(key, value, MAPPING)
        if max_length is not None and len(value) > max_length:
            bound = f"at most {max_length}"
            raise InputError(key, f"{len(value)} entries", bound, "leave some out")

        def entry(name: str) -> tuple[str, Any]:
            path = join_key(key, name)
            return names.check(path, name), kind.check(path, value[name])

        return dict(collect(entry, value))

    schema = {"type": "object", "additionalProperties": kind, "propertyNames": names}
    schema |= {} if max_length is None else {"maxProperties": max_length}
    return Kind((MAPPING,), check, schema)


def by_key(kinds: Mapping[str, Kind]) -> Kind:
    """Return the kind of mappings whose kind is that of the first key that they have.

    Mappings without such a key, and other values, have the first kind.
    """
    first = next(iter(kinds))

    def check(key: str, value: Any) -> Any:
        present = (name for name in kinds if isinstance(value, Mapping) and name in value)
        return kinds[next(present, first)].check(key, value)

    return Kind((MAPPING,), check, {"anyOf": list(kinds.values())})


def single_key(
    name: str,
    summary: str,
    records: Mapping[str, type[Any]],
    example: str,
    accepted: tuple[type[Any], ...] = (),
) -> Kind:
    """Return the kind of mappings with a single key, which names the record of its value.

    Values of the types ``accepted``, such as the records themselves, are accepted as they are. A
    record is looked up when its key is used.
    """
    noun = name.removeprefix("Team").lower()

    def example_of(kind: str) -> str:
        """Return an example of a kind with its required keys."""
        keys = keys_of(records[kind]).values()
        return f"{kind}: {_as_yaml({k.name: k.example for k in keys if k.default is EMPTY})}"

    def check(key: str, value: Any) -> Any:
        if isinstance(value, accepted):
            return value
        if isinstance(value, str) and value in records:
            raise InputError(key, value, MAPPING, f"write {example_of(value)}")
        if not isinstance(value, Mapping):
            raise form_error(key, value, MAPPING)
        if len(value) != 1:
            bound = f"a mapping with exactly one of the keys {', '.join(records)}"
            raise InputError(key, value, bound, f"write {example}")
        ((kind, content),) = value.items()
        if kind not in records:
            refuse_retired(join_key(key, kind))
            remedy = closest_word(kind, list(records))
            for each in records:
                remedy = remedy.replace(f"mean {each}?", f"mean {example_of(each)}?")
            raise InputError(join_key(key, kind), content, f"{KNOWN}{noun}", remedy)
        if form_of(content) != MAPPING:
            raise InputError(join_key(key, kind), content, MAPPING, f"write {example_of(kind)}")
        return mapping_of(records[kind]).check(join_key(key, kind), content)

    def schema(definitions: dict[str, Schema]) -> Schema:
        size = {"minProperties": 1, "maxProperties": 1}
        kinds = {key: mapping_of(record) for key, record in records.items()}
        return mapping_schema(name, summary, resolved_schema(kinds, definitions), definitions, size)

    return Kind((MAPPING,), check, schema)
