"""Configuration: defaults < file < options, frozen, unknown keys refused with the nearest known one."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, ClassVar, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator
from pydantic_core import ErrorDetails, PydanticCustomError

from posetrack_cli import limits
from posetrack_cli.errors import UsageError, nearest_name
from posetrack_cli.files import read_text
from posetrack_cli.text import parse_toml

# What pydantic calls an error, and what we say was expected; {names} are of the error's context.
_EXPECTED = {
    "int_parsing": "a whole number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "float_parsing": "a number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "greater_than": "more than {gt:g}",
    "greater_than_equal": "{ge:g} or more",
    "less_than": "less than {lt:g}",
    "less_than_equal": "{le:g} or less",
    "literal_error": "{expected}",
    "string_type": "text",
    "bool_parsing": "true or false",
    "bool_type": "true or false",
    "tuple_type": "a list of values",
    "too_short": "{min_length} values",
    "too_long": "{max_length} values",
    "model_type": "a table of settings",
}


class Settings(BaseModel):
    """Base of all configuration tables: frozen, no unknown keys, no NaN, no infinity, no true for 1."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    file_keys: ClassVar[tuple[str, ...]] = ()
    """Keys such as ``hand.mesh`` whose value names a file: in a TOML file, relative to its folder."""

    @field_validator("*", mode="before")
    @classmethod
    def _no_truth_value_as_number(cls, value: Any, info: ValidationInfo) -> Any:
        """Pydantic takes true for 1; whoever writes ``particles = true`` does not mean one particle."""
        kinds = _kinds(cls, str(info.field_name))
        values = value if isinstance(value, list | tuple) else [value]
        if bool not in kinds and any(isinstance(one, bool) for one in values):
            raise PydanticCustomError("not_a_truth_value", "a value other than true or false")
        return value


def setting(default: Any, meaning: str, *, example: Any = None) -> Any:
    """Declare a setting: all that shipped files and the reference say of it is made from here.

    Args:
        default: its value, or a table of settings.
        meaning: what it does, and other values that it can have.
        example: value of one that is nothing by default.
    """
    return Field(default, description=meaning, examples=None if example is None else [example])


Model = TypeVar("Model", bound=Settings)


def load_settings(
    model: type[Model], files: Path | Sequence[Path] | None, options: Mapping[str, Any]
) -> Model:
    """Resolve a configuration. A table that is given in part keeps the other values of what it overrides.

    Args:
        model: the configuration's type; its defaults come first.
        files: TOML files, each overrides the defaults and the files before it.
        options: ``{"filter.particles": 512}`` from the command line, override them all; None is not given.

    Raises:
        UsageError: unreadable file, unknown key, value out of range.
    """
    defaults = {name: field.default for name, field in model.model_fields.items()}
    values: dict[str, Any] = {}
    where: object = "options"
    for path in [files] if isinstance(files, Path) else files or []:
        values, where = _overridden(values, _anchored(_read_toml(path), path, model.file_keys)), path
        validated(model, _filled_up(values, defaults), path)  # so that an error names the file it is in
    for key, value in options.items():
        if value is not None:
            _put(values, key.split("."), value)
    return validated(model, _filled_up(values, defaults), where)


def validated(model: type[Model], values: Mapping[str, Any], where: object) -> Model:
    """Return the model of these values.

    Raises:
        UsageError: unknown key (with the nearest known one), or a value that cannot be used.
    """
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise _explained(error, model, where) from error


def parse_assignments(assignments: Iterable[str]) -> dict[str, Any]:
    """Return ``{"a.b": 1}`` of ``["a.b=1"]``; values as TOML has them, text without quotes too.

    Raises:
        UsageError: no equals sign, or no key before it.
    """
    values = {}
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals or not key.strip():
            raise UsageError("not an assignment", where="--set", found=assignment, expected="KEY=VALUE")
        try:
            values[key.strip()] = parse_toml(f"value = {text}")["value"]
        except ValueError:
            values[key.strip()] = text.strip()
    return values


def find_configuration(name: str | os.PathLike[str]) -> Path:
    """Return the file of a path, or of a name such as ``hand-paper`` that comes with posetrack.

    Raises:
        UsageError: there is neither.
    """
    path = Path(name)
    if path.is_file():
        return path
    shipped = shipped_files()
    if str(name) in shipped:
        return shipped[str(name)]
    if path.exists():
        return path  # a folder or a pipe: whoever reads it says so
    raise UsageError(
        "no such configuration",
        where=name,
        expected="a TOML file, or a name that comes with posetrack",
        hint=nearest_name(path.stem, shipped),
    )


def shipped_files(folder: str = "") -> dict[str, Path]:
    """Return the TOML files that come with posetrack, by name: configurations, or those of a subfolder.

    They lie inside an installed package, next to it in a checkout.
    """
    package = Path(str(resources.files("posetrack_cli")))
    folders = (package / "configs" / folder, package.parent / "configs" / folder)
    return {path.stem: path for each in folders for path in sorted(each.glob("*.toml"))}


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return parse_toml(read_text(path, limits.TEXT_BYTES))
    except OSError as error:
        raise UsageError("configuration cannot be read", where=path, found=error.strerror or error) from error
    except ValueError as error:
        raise UsageError("not a TOML file", where=path, found=error) from error


def _anchored(values: dict[str, Any], path: Path, file_keys: Iterable[str]) -> dict[str, Any]:
    """Values of a file whose file names are no longer relative to its folder."""
    for key in file_keys:
        *tables, name = key.split(".")
        table: Any = values
        for part in tables:
            table = table.get(part) if isinstance(table, dict) else None
        if isinstance(table, dict) and isinstance(table.get(name), str):
            table[name] = str(path.parent / table[name])
    return values


def _overridden(values: Mapping[str, Any], later: Mapping[str, Any]) -> dict[str, Any]:
    """Values with those of a later file put over them, table by table."""
    out = dict(values)
    for key, value in later.items():
        both_tables = isinstance(value, dict) and isinstance(out.get(key), dict)
        out[key] = _overridden(out[key], value) if both_tables else value
    return out


def _filled_up(values: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    """Values whose tables have what they leave out from the default table of the same name."""
    filled = dict(values)
    for key, default in defaults.items():
        if isinstance(default, BaseModel) and isinstance(values.get(key), dict):
            table = dict(default)
            filled[key] = table | _filled_up(values[key], table)
    return filled


def _put(values: dict[str, Any], keys: list[str], value: Any) -> None:
    for key in keys[:-1]:
        table = values.setdefault(key, {})
        if not isinstance(table, dict):
            return  # the file gives a value where a table belongs: validation says so
        values = table
    values[keys[-1]] = value


def _explained(error: ValidationError, model: type[Settings], where: object) -> UsageError:
    """The first problem as one line."""
    problems = error.errors(include_url=False)
    problem = problems[0]
    location = [str(part) for part in problem["loc"]]
    key = ".".join(location)
    if problem["type"] == "extra_forbidden":
        known = _fields_at(model, location[:-1])
        return UsageError(
            f"unknown configuration key '{key}'", where=where, hint=nearest_name(location[-1], known)
        )
    if problem["type"] == "missing":
        if isinstance(problem["loc"][-1], str):
            return UsageError(f"'{key}' is missing", where=where)
        key, expected = ".".join(location[:-1]), f"{_places(problems)} values"
    else:
        expected = expected_words(problem)
    return UsageError(f"'{key}' cannot be used", where=where, found=repr(problem["input"]), expected=expected)


def _places(problems: list[ErrorDetails]) -> int:
    """How many values a list must have that is too short; the first problem is about it."""
    row = problems[0]["loc"][:-1]
    missing = [p["loc"][-1] for p in problems if p["type"] == "missing" and p["loc"][:-1] == row]
    return 1 + max(place for place in missing if isinstance(place, int))


def expected_words(problem: ErrorDetails) -> str:
    """What should have been there, in plain words, of one of a ValidationError's ``errors()``."""
    if problem["type"] not in _EXPECTED:
        return problem["msg"].removeprefix("Input should be ")
    return _EXPECTED[problem["type"]].format(**problem.get("ctx", {}))


def _kinds(model: type[BaseModel], name: str) -> tuple[Any, ...]:
    """The type of a field, and what it is made of: ``int | None`` gives itself, int and None."""
    field = model.model_fields.get(name)
    return () if field is None else (field.annotation, *get_args(field.annotation))


def _fields_at(model: type[BaseModel], location: list[str]) -> list[str]:
    """Names of the keys in the table at a location."""
    for part in location:
        if part.isdecimal():  # of a list of tables
            continue
        kinds = _kinds(model, part)
        tables = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]
        if not tables:
            return []
        model = tables[0]
    return list(model.model_fields)
