"""Configuration: defaults < files < options, immutable; unknown keys are refused with a suggestion."""

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

# Expected value by pydantic error type; {names} come from the error's context.
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
    """Base of all configuration tables: immutable; no unknown keys, NaN, infinity or booleans as numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    file_keys: ClassVar[tuple[str, ...]] = ()
    """Keys such as ``hand.mesh`` whose value is a path, relative to the TOML file's folder."""
    renamed_keys: ClassVar[Mapping[str, str]] = {}
    """Former keys of this table and their current names; errors point to the new name."""

    @field_validator("*", mode="before")
    @classmethod
    def _no_truth_value_as_number(cls, value: Any, info: ValidationInfo) -> Any:
        """Refuse booleans for numbers, as pydantic would read ``particles = true`` as 1."""
        kinds = _kinds(cls, str(info.field_name))
        values = value if isinstance(value, list | tuple) else [value]
        if bool not in kinds and any(isinstance(one, bool) for one in values):
            raise PydanticCustomError("not_a_truth_value", "a value other than true or false")
        return value


def setting(default: Any, meaning: str, *, example: Any = None) -> Any:
    """Declare a setting; shipped files and the reference are generated from these declarations.

    Args:
        default: default value, or a table of settings.
        meaning: description, including other possible values.
        example: example value of a setting that is unset by default.
    """
    return Field(default, description=meaning, examples=None if example is None else [example])


Model = TypeVar("Model", bound=Settings)


def load_settings(
    model: type[Model], files: Path | Sequence[Path] | None, options: Mapping[str, Any]
) -> Model:
    """Resolve a configuration; partially given tables keep the other values of the table they override.

    Args:
        model: configuration type, which provides the defaults.
        files: TOML files; each overrides the defaults and the files before it.
        options: command-line values such as ``{"filter.particles": 512}``, which override files; None means
            not given.

    Raises:
        UsageError: unreadable file, unknown key, or invalid value.
    """
    defaults = {name: field.default for name, field in model.model_fields.items()}
    values: dict[str, Any] = {}
    where: object = "options"
    for path in [files] if isinstance(files, Path) else files or []:
        values, where = _overridden(values, _anchored(_read_toml(path), path, model.file_keys)), path
        validated(model, _filled_up(values, defaults), path)  # after each file, so that errors name it
    for key, value in options.items():
        if value is not None:
            _put(values, key.split("."), value)
    return validated(model, _filled_up(values, defaults), where)


def validated(model: type[Model], values: Mapping[str, Any], where: object) -> Model:
    """Return the model of these values.

    Raises:
        UsageError: unknown key (with a suggestion) or invalid value.
    """
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise _explained(error, model, where) from error


def parse_assignments(assignments: Iterable[str]) -> dict[str, Any]:
    """Return ``{"a.b": 1}`` for ``["a.b=1"]``; values are TOML, or plain text without quotes.

    Raises:
        UsageError: no equals sign or no key.
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
    """Return the file of a path or of a shipped configuration such as ``hand-paper``.

    Raises:
        UsageError: neither exists.
    """
    path = Path(name)
    if path.is_file():
        return path
    shipped = shipped_files()
    if str(name) in shipped:
        return shipped[str(name)]
    if path.exists():
        return path  # a folder or pipe; reading it reports the error
    raise UsageError(
        "no such configuration",
        where=name,
        expected="a TOML file or the name of a shipped configuration",
        hint=nearest_name(path.stem, shipped),
    )


def shipped_files(folder: str = "") -> dict[str, Path]:
    """Return the shipped TOML files by name: configurations, or those of a subfolder.

    They are inside an installed package, or next to it in a checkout.
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
    """Return the values with paths resolved relative to the file's folder."""
    for key in file_keys:
        *tables, name = key.split(".")
        table: Any = values
        for part in tables:
            table = table.get(part) if isinstance(table, dict) else None
        if isinstance(table, dict) and isinstance(table.get(name), str):
            table[name] = str(path.parent / table[name])
    return values


def _overridden(values: Mapping[str, Any], later: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values overridden by a later file, table by table."""
    out = dict(values)
    for key, value in later.items():
        both_tables = isinstance(value, dict) and isinstance(out.get(key), dict)
        out[key] = _overridden(out[key], value) if both_tables else value
    return out


def _filled_up(values: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values with partial tables completed from the defaults."""
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
            return  # a value in place of a table; validation reports it
        values = table
    values[keys[-1]] = value


def _explained(error: ValidationError, model: type[Settings], where: object) -> UsageError:
    """Return an error describing the first problem."""
    problems = error.errors(include_url=False)
    problem = problems[0]
    location = [str(part) for part in problem["loc"]]
    key = ".".join(location)
    if problem["type"] == "extra_forbidden":
        table = _table_at(model, location[:-1])
        name = table.renamed_keys.get(location[-1]) if table is not None else None
        if name is not None:
            renamed = ".".join([*location[:-1], name])
            return UsageError(f"configuration key '{key}' was renamed", where=where, hint=f"use '{renamed}'")
        known = [] if table is None else list(table.model_fields)
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
    """Return the required length of a list that is too short, as in the first problem."""
    row = problems[0]["loc"][:-1]
    missing = [p["loc"][-1] for p in problems if p["type"] == "missing" and p["loc"][:-1] == row]
    return 1 + max(place for place in missing if isinstance(place, int))


def expected_words(problem: ErrorDetails) -> str:
    """Return the expected value of one of a ValidationError's ``errors()`` in plain words."""
    if problem["type"] not in _EXPECTED:
        return problem["msg"].removeprefix("Input should be ")
    return _EXPECTED[problem["type"]].format(**problem.get("ctx", {}))


def _kinds(model: type[BaseModel], name: str) -> tuple[Any, ...]:
    """Return a field's type and its arguments: ``int | None`` gives the union, int and None."""
    field = model.model_fields.get(name)
    return () if field is None else (field.annotation, *get_args(field.annotation))


def _table_at(model: type[Settings], location: list[str]) -> type[Settings] | None:
    """Return the type of the table at a location, None if there is no table."""
    for part in location:
        if part.isdecimal():  # index into a list of tables
            continue
        kinds = _kinds(model, part)
        tables = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Settings)]
        if not tables:
            return None
        model = tables[0]
    return model
