"""Declare commands and their options."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hitchopt.cli import main
from hitchopt.cli.output import output
from hitchopt.errors import UNKNOWN_KEY, FileError, InputError
from hitchopt.retired import gone, refuse_retired

if TYPE_CHECKING:
    from hitchopt.values.fields import Key

SUFFIXES = (".yaml", ".yml")  # Suffixes of problem files


class NonEmptyPath(click.Path):
    """A path that is not empty, unlike the value of an unset shell variable."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; raises InputError if it is empty."""
        if value == "" and param is not None:
            raise InputError(
                _key(param), "", "a path that is not empty", "name one; . is this directory"
            )
        return super().convert(value, param, ctx)


PATH = NonEmptyPath()


class Number(click.types.FloatParamType):
    """A number, refused as numbers in files are."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number; raises InputError for other values."""
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter:
            raise InputError(_key(param), value, "a number", "write it without a unit") from None


class WholeNumber(click.types.IntParamType):
    """A whole number, validated as in problem files."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number; raises InputError for other values."""
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter:
            raise InputError(_key(param), value, "an integer", "use a whole number") from None


class Choice(click.Choice[str]):
    """One of some words."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the word; raises BadParameter for others."""
        if ctx is not None and (sentence := gone(f"{ctx.info_name} {_key(param)} {value}")):
            raise click.UsageError(sentence, ctx)
        return super().convert(value, param, ctx)


def _key(param: click.Parameter | None) -> str:
    """Return the name of an option, or of an argument as help shows it."""
    if isinstance(param, click.Option):
        return param.opts[-1]
    return "" if param is None else param.human_readable_name


def _named(kind: click.ParamType[Any]) -> click.ParamType[Any]:
    """Return the type whose numbers, also those of tuples, are refused by InputError."""
    if isinstance(kind, click.Tuple):
        return click.Tuple([_named(each) for each in kind.types])
    if kind is click.FLOAT:
        return Number()
    return WholeNumber() if kind is click.INT else kind


def option(
    names: str,
    description: str,
    value: Any = False,
    metavar: str | None = None,
    *,
    choices: Sequence[str] = (),
    **more: Any,
) -> click.Option:
    """Return an option.

    ``value`` is the default, or the type if there is none; False is the default of a flag. ``more``
    are further arguments of ``click.Option``.
    """
    settings: dict[str, Any] = {"help": description, "metavar": metavar}
    if isinstance(value, type | click.ParamType):
        settings["type"] = value
    else:
        settings |= {"default": value, "nargs": len(value) if isinstance(value, tuple) else 1}
    if choices:
        settings["type"] = Choice(choices)
    elif value is False:
        settings["is_flag"] = True
    made = click.Option(names.split(), **settings, **more)
    made.type = _named(made.type)
    return made


def key_option(names: str, key: Key, metavar: str | None = None) -> click.Option:
    """Return the option for a key of a record, with the key's meaning, unit in files and default.

    Flags that are not False by default have two names, such as ``--upload/--stream``.
    """
    from hitchopt.values import FLAG  # imports numpy, which --help does without
    from hitchopt.values.fields import EMPTY

    kind = key.file_kind
    description = f"{key.described(kind)}.".replace("null:", "default:")
    default = None if key.default is EMPTY else key.to_file(key.default)
    if kind.forms == (FLAG,):
        return option(names, description, default)
    choices = kind.schema.get("enum", ())
    if default is None:
        types: dict[str, type] = {"integer": int, "string": str}
        default = str if choices else types.get(kind.schema["type"], float)
    return option(
        names, description, default, metavar or kind.unit.upper() or None, choices=choices
    )


def assignment_option(name: str, description: str, keys: Mapping[str, Key]) -> click.Option:
    """Return the option for values of keys, ``KEY=VALUE``, that may be given several times.

    Its value is a mapping of fields to values.
    """
    listed = "; ".join(f"{name}: {_meaning(key)}" for name, key in keys.items())

    def assigned(_: click.Context, option: click.Parameter, pairs: Sequence[str]) -> dict[str, Any]:
        return dict(_assignment(option.opts[0], pair, keys) for pair in pairs)

    words = f"{description} Keys are {listed}."
    return option(name, words, str, "KEY=VALUE", multiple=True, callback=assigned)


def _meaning(key: Key) -> str:
    """Return the meaning of a key, with its unit in files and a default that is not zero."""
    meaning, default = key.described(key.file_kind), key.to_file(key.default)
    usual = f", {default:g} by default" if isinstance(default, float) and default else ""
    return f"{meaning[0].lower()}{meaning[1:].replace('; null:', ', by default')}{usual}"


def _assignment(option: str, pair: str, keys: Mapping[str, Key]) -> tuple[str, Any]:
    """Return the field and the value of a text ``KEY=VALUE`` of an option."""
    from hitchopt.storage.yaml_file import parse_yaml  # heavy
    from hitchopt.values import closest_word

    name, equals, value = pair.partition("=")
    name = name.strip().replace("-", "_")
    if not equals:
        raise InputError(option, pair, "KEY=VALUE", f"write {next(iter(keys))}=0.1")
    if name not in keys:
        refuse_retired(f"{option} {name}")
        raise InputError(option, name, UNKNOWN_KEY, closest_word(name, list(keys)))
    return name, keys[name].from_file(f"{option} {name}", parse_yaml(value, option))


def width_option(of: str) -> click.Option:
    """Return the option for the width of a figure for a paper."""
    words = f"Width of {of} for a paper; all text is then 8 pt."
    return option("--width", words, float, "INCHES")


def paper_option(of: str = "the picture") -> click.Option:
    """Return the option for the width of a picture among other results; with it, this is a PDF."""
    return width_option(f"{of}, a PDF")


def picture_format(width: float | None) -> str:
    """Return the format of a picture among other results."""
    return "png" if width is None else "pdf"


Options = click.Option | Callable[[], Sequence[click.Option]]
"""An option, or a function that returns options which heavy records declare."""


class Command(click.Command):
    """A command whose options are declared on first use, not when ``--help`` lists it.

    Parameters are those of ``click.Command``; ``params`` may contain functions (``Options``).
    """

    _params: list[Any]

    @property
    def params(self) -> list[click.Parameter]:
        """The parameters."""
        if any(not isinstance(each, click.Parameter) for each in self._params):
            self._params = [
                parameter
                for each in self._params
                for parameter in ([each] if isinstance(each, click.Parameter) else each())
            ]
        return self._params

    @params.setter
    def params(self, params: list[Any]) -> None:
        self._params = params


def command(
    argument: str, *options: Options, **more: Any
) -> Callable[[Callable[..., None]], click.Command]:
    """Return a decorator that turns a function into a command of the same name.

    ``argument`` is the name and the metavar of a parameter, such as ``directory DIR``. It is a
    path by default; ``more`` are further arguments of ``click.Argument``.
    """
    name, metavar = argument.split()
    parameter = click.Argument([name], metavar=metavar, **{"type": PATH, **more})
    switch: Any = {"expose_value": False, "callback": _switch}
    switches = (
        option("--json", "Print one JSON object to stdout, everything else to stderr.", **switch),
        option("-q --quiet", "Print errors only.", **switch),
        option("-v --verbose", "Print every progress message to stderr.", **switch),
    )
    return main.command(cls=Command, params=[parameter, *options, *switches])


def _switch(_: click.Context, option: click.Parameter, value: bool) -> None:
    setattr(output(), str(option.name), value)


def completing(names: Callable[[], Iterable[str]]) -> dict[str, Any]:
    """Return arguments of an option whose values are completed in the shell."""
    return {"shell_complete": lambda _, __, prefix: [x for x in names() if x.startswith(prefix)]}


def plan_path(path: Path) -> Path:
    """Return the path of the plan in a directory; the path of a plan is returned unchanged.

    Raises FileError for a problem file.
    """
    from hitchopt.storage.archive import PLAN

    if path.suffix in SUFFIXES and path.is_file():
        remedy = "run hitchopt solve on it, and name the directory that it wrote"
        raise FileError(f"{path}: a problem, not a plan: {remedy}")
    is_plan = path.is_file() or (path.name == PLAN and not path.is_dir())
    return path if is_plan else path / PLAN
