"""Damaged checkpoints: keys left out, values and arrays of other kinds, with the digest they should have."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import partial
from io import BytesIO
from typing import Any

import numpy as np

from posetrack_cli.npz import read_npz
from posetrack_cli.results import spool

Arrays = dict[str, np.ndarray[Any, Any]]
OTHER_VALUES = (-7, 2**130, 1e300, float("nan"), None, "text", [], {}, True)
OTHER_NUMBERS = (np.nan, np.inf, -np.inf, 1e300)
OTHER_TYPES = {"f": np.float32, "i": np.float64, "b": np.uint8, "u": np.int16, "U": np.bytes_}


def sealed(contents: Arrays) -> bytes:
    """A checkpoint's file with these contents and the digest that belongs to them."""
    digest = np.frombuffer(spool._digest(contents), np.uint8)
    stream = BytesIO()
    np.savez(stream, **(contents | {"digest": digest}))  # type: ignore[arg-type]
    return stream.getvalue()


def changed_json(contents: Arrays, change: Any) -> bytes:
    """A checkpoint's file after a change of its JSON, with the digest that belongs to it."""
    fields = json.loads(contents["json"].tobytes())
    change(fields)
    return sealed(contents | {"json": np.frombuffer(json.dumps(fields).encode(), np.uint8)})


def damaged_fields(data: bytes) -> Iterator[tuple[str, bytes]]:
    """What a checkpoint's JSON could be, one key after the other left out or of another value."""
    contents = read_npz(data)
    for path in _paths(json.loads(contents["json"].tobytes())):
        name = ".".join(path)
        yield f"without {name}", changed_json(contents, partial(_left_out, path))
        for value in OTHER_VALUES:
            if value == -7 and name.endswith("_ns"):
                continue  # a time as good as any
            yield f"{name} {value!r:.20}", changed_json(contents, partial(_put, path, value))


def damaged_arrays(arrays: Arrays) -> Iterator[tuple[str, Arrays]]:
    """What a state's arrays could be: each left out, of another type or shape, or in another's place."""
    names = list(arrays)
    for name, following in zip(names, names[1:] + names[:1], strict=True):
        array = arrays[name]
        yield f"without {name}", {other: values for other, values in arrays.items() if other != name}
        others = {
            "of another type": array.astype(OTHER_TYPES[array.dtype.kind]),
            "of text": np.full(array.shape, b"text"),
            "with another axis": array[None],
            "of no length": np.empty((0, 10**15), array.dtype),
        }
        if array.ndim > 1:
            others["of one axis"] = array.ravel()
        for what, values in others.items():
            yield f"{name} {what}", arrays | {name: values}
        yield f"{name} and {following}", arrays | {name: arrays[following], following: array}


def wild_numbers(arrays: Arrays) -> Iterator[tuple[str, Arrays]]:
    """What a state's arrays could be: of the right kinds, with numbers that are none or too large."""
    for name, array in arrays.items():
        if array.dtype.kind == "f" and array.size:
            for value in OTHER_NUMBERS:
                one = array.copy()
                one.flat[array.size // 2] = value
                yield f"{name} with {value}", arrays | {name: one}
        if array.dtype.kind == "i" and array.size:
            for whole in (-1, 2**63 - 1, -(2**63)):
                yield f"{name} of {whole}", arrays | {name: np.full_like(array, whole)}


def _holder(path: tuple[str, ...], fields: Any) -> Any:
    for key in path[:-1]:
        fields = fields[key]
    return fields


def _left_out(path: tuple[str, ...], fields: Any) -> None:
    del _holder(path, fields)[path[-1]]


def _put(path: tuple[str, ...], value: Any, fields: Any) -> None:
    _holder(path, fields)[path[-1]] = value


def _paths(value: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield (*path, key)
            yield from _paths(inner, (*path, key))
