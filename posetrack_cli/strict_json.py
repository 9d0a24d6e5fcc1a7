"""Strict parsing of JSON from files: types, ranges and lengths checked in one pass."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from pydantic_core import CoreConfig, CoreSchema, SchemaValidator, ValidationError
from pydantic_core import core_schema as schemas

from posetrack_cli import limits

_CONFIG = CoreConfig(allow_inf_nan=False)
_SHOWN_CHARACTERS = 60


def number_from(least: float, most: float) -> schemas.FloatSchema:
    """Return the schema of a finite number in a range."""
    return schemas.float_schema(ge=least, le=most, strict=True)


def integer_from(least: int, most: int) -> schemas.IntSchema:
    """Return the schema of an integer in a range."""
    return schemas.int_schema(ge=least, le=most, strict=True)


def text_of(least: int, most: int = limits.NAME_CHARACTERS) -> schemas.StringSchema:
    """Return the schema of text with a range of lengths."""
    return schemas.str_schema(min_length=least, max_length=most, strict=True)


NAME = text_of(1)
LENGTH_MM = number_from(-limits.LENGTH_MM, limits.LENGTH_MM)
NUMBER = number_from(-limits.NUMBER, limits.NUMBER)
NOT_NEGATIVE = number_from(0.0, limits.NUMBER)
COUNT = integer_from(0, limits.INTEGER)
TRUTH_VALUE = schemas.bool_schema(strict=True)


def list_of(
    item: CoreSchema, length: int | None = None, most: int = limits.LIST_ENTRIES
) -> schemas.ListSchema:
    """Return the schema of a list with a fixed or maximum length."""
    return schemas.list_schema(item, min_length=length, max_length=most if length is None else length)


def object_of(
    required: Mapping[str, CoreSchema], optional: Mapping[str, CoreSchema] | None = None
) -> schemas.TypedDictSchema:
    """Return the schema of an object; optional keys may be missing or null, other keys are ignored."""
    fields = {name: schemas.typed_dict_field(schema) for name, schema in required.items()}
    for name, schema in (optional or {}).items():
        fields[name] = schemas.typed_dict_field(schemas.nullable_schema(schema), required=False)
    return schemas.typed_dict_schema(fields, extra_behavior="ignore")


def reader_of(schema: CoreSchema, most: int | None = None) -> Callable[[bytes | str], Any]:
    """Return a function that parses JSON of a schema without rounding, up to ``most`` bytes.

    It raises ValueError with a one-line message for anything else, including NaN, infinity, booleans or
    text as numbers, and deep nesting.
    """
    validate = SchemaValidator(schema, _CONFIG).validate_json

    def read(text: bytes | str) -> Any:
        if most is not None and len(text) > most:
            raise ValueError(f"{len(text)} bytes exceed the limit of {most}")
        try:
            return validate(text)
        except ValidationError as error:
            raise ValueError(_first_problem(error)) from None

    return read


def _first_problem(error: ValidationError) -> str:
    """Return the first problem as one line: place, found, expected."""
    from posetrack_cli.configuration import expected_words  # pydantic is slow to load

    problem = error.errors(include_url=False)[0]
    if problem["type"] == "json_invalid":
        return str(problem["msg"])
    where = ".".join(str(part) for part in problem["loc"]) or "value"
    if problem["type"] == "missing":
        return f"'{where}' is missing"
    found = repr(problem["input"])
    # The value may be arbitrarily long, as it comes from the file.
    found = found if len(found) <= _SHOWN_CHARACTERS else f"{found[:_SHOWN_CHARACTERS]}..."
    return f"'{where}' is {found}, expected {expected_words(problem)}"
