"""Arrays in pickles of untrusted origin: opcodes are read, nothing is imported or called."""

from __future__ import annotations

import codecs
import pickletools
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np

from posetrack_cli.arrays import FloatArray

_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "EMPTY_TUPLE": ()}
_SMALL_TUPLES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}
_IGNORED = ("PROTO", "FRAME", "STOP")
# Functions by which numpy and Python 3 store arrays; all others are refused, and these are not called either.
_ARRAY, _SCALAR, _DTYPE, _ENCODE = "_reconstruct", "scalar", "dtype", "encode"
_GLOBALS = {
    **{f"numpy{core}.multiarray {name}": name for core in (".core", "._core") for name in (_ARRAY, _SCALAR)},
    "numpy dtype": _DTYPE,
    "numpy ndarray": "ndarray",
    "_codecs encode": _ENCODE,
}
_BY_CODE = {opcode.code: opcode for opcode in pickletools.opcodes}
_MARK = object()


@dataclass
class _Call:
    """A stored call, with the state that would be given to its value."""

    name: str
    args: tuple[Any, ...]
    state: Any = None


def read_pickled(data: bytes) -> Any:
    """Return the value of a pickle of numbers, text, lists, tuples, dicts with text keys, and numpy arrays.

    Raises:
        ValueError: it is damaged, or contains anything else.
    """
    stack: list[Any] = []
    memo: dict[int, Any] = {}
    try:
        for opcode, argument in _opcodes(data):
            _apply(opcode, argument, stack, memo)
        (value,) = stack
    except (IndexError, KeyError, TypeError, AttributeError) as error:
        raise ValueError("damaged pickle") from error
    return value


def array_of(value: Any) -> FloatArray | None:
    """Return an array of numbers that ``read_pickled`` found, as float64; None for another value."""
    if not isinstance(value, _Call) or value.name != _ARRAY or not isinstance(value.state, tuple):
        return None
    _, shape, dtype, fortran, content = value.state
    if isinstance(content, _Call) and content.name == _ENCODE:
        content = content.args[0]
    content = content.encode("latin-1") if isinstance(content, str) else content
    code = dtype.args[0] if isinstance(dtype, _Call) and dtype.name == _DTYPE else None
    if code not in ("f4", "f8", "i4", "i8") or not isinstance(content, bytes):
        raise ValueError("pickled array is not numeric")
    order = dtype.state[1] if isinstance(dtype.state, tuple) else "<"
    values = np.frombuffer(content, np.dtype(f"{'>' if order == '>' else '<'}{code}"))
    return values.reshape(shape, order="F" if fortran else "C").astype(np.float64)


def _opcodes(data: bytes) -> Iterator[tuple[pickletools.OpcodeInfo, Any]]:
    """Yield opcodes and arguments; ``pickletools.genops`` refuses strings of Python 2 that are not ASCII."""
    stream = BytesIO(data)
    while code := stream.read(1):
        opcode = _BY_CODE[code.decode("latin-1")]
        if opcode.name == "STRING":
            text = pickletools.read_stringnl(stream, decode=False)
            yield opcode, codecs.escape_decode(text)[0].decode("latin-1")
        else:
            yield opcode, None if opcode.arg is None else opcode.arg.reader(stream)
        if opcode.name == "STOP":
            return
    raise ValueError("pickle ends early")


def _apply(opcode: pickletools.OpcodeInfo, argument: Any, stack: list[Any], memo: dict[int, Any]) -> None:
    """Execute one opcode."""
    name = opcode.name
    pushed = opcode.stack_after if not opcode.stack_before else []
    if name in _CONSTANTS or (argument is not None and pushed and pushed[0] is not pickletools.anyobject):
        stack.append(_CONSTANTS.get(name, argument))
    elif name == "MARK":
        stack.append(_MARK)
    elif name in ("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"):
        memo[len(memo) if name == "MEMOIZE" else argument] = stack[-1]
    elif name in ("GET", "BINGET", "LONG_BINGET"):
        stack.append(memo[argument])
    elif name in ("GLOBAL", "STACK_GLOBAL", "REDUCE", "BUILD"):
        _call(name, argument, stack)
    elif name not in _IGNORED:
        _collect(name, stack)


def _collect(name: str, stack: list[Any]) -> None:
    """Execute an opcode of lists, tuples and dicts."""
    if name in ("EMPTY_LIST", "EMPTY_DICT"):
        stack.append([] if name == "EMPTY_LIST" else {})
    elif name in _SMALL_TUPLES:
        stack[-_SMALL_TUPLES[name] :] = [tuple(stack[-_SMALL_TUPLES[name] :])]
    elif name in ("TUPLE", "LIST", "DICT"):
        items = _marked(stack)
        stack.append(tuple(items) if name == "TUPLE" else items if name == "LIST" else _pairs(items))
    elif name in ("APPEND", "APPENDS"):
        items = [stack.pop()] if name == "APPEND" else _marked(stack)
        stack[-1].extend(items)
    elif name in ("SETITEM", "SETITEMS"):
        items = [stack.pop(-2), stack.pop()] if name == "SETITEM" else _marked(stack)
        stack[-1].update(_pairs(items))
    else:
        raise ValueError(f"pickle has opcode {name}")


def _call(name: str, argument: Any, stack: list[Any]) -> None:
    if name in ("GLOBAL", "STACK_GLOBAL"):
        parts = [argument] if name == "GLOBAL" else [stack.pop(-2), stack.pop()]
        found = " ".join(parts)
        if found not in _GLOBALS:
            raise ValueError(f"pickle refers to {found[:80]!r}")
        stack.append(_Call(_GLOBALS[found], ()))
    elif name == "REDUCE":
        args = stack.pop()
        stack[-1] = _Call(stack[-1].name, args)
    else:
        state = stack.pop()
        stack[-1].state = state


def _marked(stack: list[Any]) -> list[Any]:
    """Remove and return the items above the last mark."""
    at = len(stack) - 1
    while stack[at] is not _MARK:
        at -= 1
        if at < 0:
            raise ValueError("damaged pickle")
    items = stack[at + 1 :]
    del stack[at:]
    return items


def _pairs(items: list[Any]) -> dict[str, Any]:
    """Return pairs as a dict; hashing nested keys could exhaust the stack, so only text is accepted."""
    if not all(isinstance(key, str) for key in items[::2]):
        raise ValueError("pickle has a key that is not text")
    return dict(zip(items[::2], items[1::2], strict=True))
