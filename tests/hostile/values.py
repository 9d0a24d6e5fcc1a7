"""Values at the edges, and structures and bytes with parts of them changed."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterable
from typing import Any

from hypothesis import strategies as st

INTEGERS = (0, 1, -1, 2, 3, 7, 127, 128, 255, 256, 65535, 65536, 2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**53)
LARGE = (2**62, 2**63 - 1, 2**63, 2**64 - 1, 2**64, 10**18, 10**30, -(2**31), -(2**63), -(2**64))
FLOATS = (
    0.0,
    -0.0,
    1e-320,
    1e-9,
    0.5,
    -1.0,
    1e9,
    1e30,
    1e39,
    1e154,
    1e300,
    -1e300,
    math.inf,
    -math.inf,
    math.nan,
)
TEXTS = (
    "",
    " ",
    "a",
    "\0",
    "\n",
    "a\nposetrack: b",
    "a\r\x1b[2K",
    "\x1b]0;title\x07",
    "\x1b[31mred",
    "\x9b31m",
    "\u202egnp.exe",
    "\u2066a\u2069",
    "\u2028",
    "\ud800",
    "\U0001f600",
    "/",
    "..",
    "../../pwned",
    "/etc/passwd",
    "a/b",
    "-o",
    "x" * 300,
    "x" * 70_000,
    '__import__("os").system("id>pwned")',
    "%s%n{0.__class__}",
    "$(id>pwned)",
    "1e999",
    "nan",
    "null",
    "1" * 5000,
    "[" * 3000,
)


def numbers() -> st.SearchStrategy[Any]:
    return st.one_of(
        st.sampled_from(INTEGERS), st.sampled_from(LARGE), st.sampled_from(FLOATS), st.integers(-10, 300)
    )


def integers() -> st.SearchStrategy[int]:
    return st.one_of(st.sampled_from(INTEGERS + LARGE), st.integers(0, 300), st.integers(0, 2**64 - 1))


def texts() -> st.SearchStrategy[str]:
    return st.one_of(st.sampled_from(TEXTS), st.text(max_size=8))


def leaves() -> st.SearchStrategy[Any]:
    return st.one_of(
        numbers(), texts(), st.none(), st.booleans(), st.sampled_from(([], {}, [[]], [None], [0] * 1000))
    )


def trees() -> st.SearchStrategy[Any]:
    """Any JSON value of a few entries; sometimes nested far."""
    small = st.recursive(
        leaves(),
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts(), inner, max_size=3),
        max_leaves=6,
    )
    return st.one_of(small, st.builds(nested, st.sampled_from((10, 100, 900, 5000)), st.booleans()))


def nested(depth: int, mapping: bool) -> Any:
    value: Any = 1
    for _ in range(depth):
        value = {"a": value} if mapping else [value]
    return value


class _Held:
    """Arguments that hypothesis does not print: whole files are among them."""

    def __init__(self, arguments: tuple[Any, ...], named: dict[str, Any]) -> None:
        self.arguments, self.named = arguments, named

    def __repr__(self) -> str:
        return "..."


def composite(function: Callable[..., Any]) -> Callable[..., st.SearchStrategy[Any]]:
    """As ``hypothesis.strategies.composite``, of arguments of any size."""

    def drawn(draw: st.DrawFn, held: _Held) -> Any:
        return function(draw, *held.arguments, **held.named)

    made = st.composite(drawn)
    return lambda *arguments, **named: made(_Held(arguments, named))


def one_of(values: Iterable[Any]) -> st.SearchStrategy[Any]:
    """As ``hypothesis.strategies.sampled_from``, of values of any size."""
    held = list(values)
    return st.integers(0, len(held) - 1).map(lambda k: held[k])


@composite
def changed_tree(draw: st.DrawFn, tree: Any, most: int = 3) -> Any:
    """A JSON value with one to ``most`` places changed."""
    for _ in range(draw(st.integers(1, most))):
        tree = _changed_once(draw, tree)
    return tree


def _changed_once(draw: st.DrawFn, tree: Any) -> Any:
    """Walk down to a place and change it there."""
    if isinstance(tree, (dict, list)) and tree and draw(st.integers(0, 9)) > 0:
        keys = list(tree) if isinstance(tree, dict) else range(len(tree))
        key = draw(st.sampled_from(keys))
        copy: Any = dict(tree) if isinstance(tree, dict) else list(tree)
        how = draw(st.sampled_from(("into", "into", "into", "into", "into", "delete", "double", "rename")))
        if how == "into":
            copy[key] = _changed_once(draw, tree[key])
        elif how == "delete":
            del copy[key]
        elif isinstance(copy, list):
            copy.insert(key, copy[key])
        else:
            copy[draw(texts())] = copy.pop(key) if how == "rename" else copy[key]
        return copy
    if isinstance(tree, (int, float)) and not isinstance(tree, bool) and draw(st.booleans()):
        return draw(numbers())
    if isinstance(tree, str) and draw(st.booleans()):
        return draw(texts())
    return draw(trees())


def json_text(tree: Any) -> str:
    """Return JSON, however deep, with NaN and surrogates where they are."""
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(20_000)
    try:
        # What dumps calls is C, whose depth Python 3.12 limits on its own; piece by piece it is Python's.
        return "".join(json.JSONEncoder().iterencode(tree))
    finally:
        sys.setrecursionlimit(limit)


@composite
def changed_bytes(draw: st.DrawFn, data: bytes, most: int = 4) -> bytes:
    """Bytes with parts overwritten, cut out, doubled or inserted, or the end missing."""
    for _ in range(draw(st.integers(1, most))):
        change = draw(st.sampled_from(_BYTE_CHANGES))
        data = change(draw, data, draw(st.integers(0, max(0, len(data) - 1))))
    return data


def _overwrite(draw: st.DrawFn, data: bytes, place: int) -> bytes:
    new = draw(st.one_of(st.binary(min_size=1, max_size=8), packed_numbers()))
    return data[:place] + new + data[place + len(new) :]


def _cut_out(draw: st.DrawFn, data: bytes, place: int) -> bytes:
    return data[:place] + data[place + draw(st.integers(1, 40)) :]


def _double(draw: st.DrawFn, data: bytes, place: int) -> bytes:
    length = draw(st.integers(1, 100))
    return data[:place] + data[place : place + length] * 2 + data[place + length :]


def _insert(draw: st.DrawFn, data: bytes, place: int) -> bytes:
    new = draw(st.one_of(st.binary(max_size=40), st.just(bytes(1000)), texts().map(utf8)))
    return data[:place] + new + data[place:]


def _truncate(draw: st.DrawFn, data: bytes, place: int) -> bytes:
    return data[:place]


def _low_bit(draw: st.DrawFn, data: bytes, place: int) -> bytes:
    return (
        data[:place] + bytes([data[place] ^ (1 << draw(st.integers(0, 7)))]) + data[place + 1 :]
        if data
        else data
    )


_BYTE_CHANGES: tuple[Callable[[st.DrawFn, bytes, int], bytes], ...] = (
    _overwrite,
    _overwrite,
    _cut_out,
    _double,
    _insert,
    _truncate,
    _low_bit,
)


def packed_numbers() -> st.SearchStrategy[bytes]:
    """Numbers at the edges as 1, 2, 4 or 8 bytes of either order."""
    return st.builds(
        lambda number, width, order: (number % (1 << 8 * width)).to_bytes(width, order),
        integers(),
        st.sampled_from((1, 2, 4, 8)),
        st.sampled_from(("little", "big")),
    )


def utf8(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")


@composite
def changed_text(draw: st.DrawFn, text: str, pieces: tuple[str, ...] = ()) -> bytes:
    """A text of lines with words, lines and bytes changed."""
    lines = text.split("\n")
    for _ in range(draw(st.integers(1, 3))):
        how = draw(st.sampled_from(("word", "word", "word", "line", "delete", "double", "swap", "bytes")))
        k = draw(st.integers(0, len(lines) - 1))
        if how == "word":
            lines[k] = _changed_word(draw, lines[k], pieces)
        elif how == "line":
            lines[k] = draw(st.one_of(texts(), st.sampled_from(pieces) if pieces else texts()))
        elif how == "delete" and len(lines) > 1:
            del lines[k]
        elif how == "double":
            lines.insert(k, lines[k])
        elif how == "swap":
            lines.append(lines.pop(k))
        elif how == "bytes":
            return draw(changed_bytes(utf8("\n".join(lines))))
    return utf8("\n".join(lines))


def _changed_word(draw: st.DrawFn, line: str, pieces: tuple[str, ...]) -> str:
    """One of the words between separators becomes another."""
    import re

    words = re.split(r"([,=\s\[\]]+)", line)
    k = draw(st.integers(0, len(words) - 1))
    new = st.one_of(numbers().map(str), texts(), *([st.sampled_from(pieces)] if pieces else []))
    words[k] = draw(new)
    return "".join(words)
