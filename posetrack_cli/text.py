"""Text from strangers: made safe to print, and read as TOML without taking time without end.

Terminals obey control characters, and readers believe reversed text.
"""

from __future__ import annotations

import re
import tomllib
from typing import Any

from posetrack_cli import limits

# C0 but tab and line feed, DEL, C1; marks, embeddings, overrides and isolates of bidirectional text; the
# line and paragraph separators, which some viewers take for line feeds; surrogates, by which Python holds
# bytes of names that are not UTF-8.
_CONTROLS = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]"
)


def printable(text: str) -> str:
    """Return text with its control characters as escapes such as ``\\x1b``; tabs and line feeds stay."""
    return _CONTROLS.sub(_escape, text)


def one_line(text: str) -> str:
    """Return printable text whose line feeds are escapes, too: a name must not begin a line of its own."""
    return printable(text).replace("\n", "\\n")


def printable_json(text: str) -> str:
    """Return JSON without control characters within its strings, which still mean the same."""
    return _CONTROLS.sub(lambda found: f"\\u{ord(found.group()):04x}", text)


def _escape(found: re.Match[str]) -> str:
    code = ord(found.group())
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"


_PART = r"""(?:[A-Za-z0-9_-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*"""
_DEEP_KEY = re.compile(rf"(?:^[ \t\[]*|[{{,][ \t]*){_PART * limits.KEY_PARTS}", re.MULTILINE)


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text.

    Raises:
        ValueError: it is no TOML, nested without end, or has integers of thousands of digits.
    """
    if _DEEP_KEY.search(text):  # the standard library's parser takes a second for a key of some kilobytes
        raise ValueError(f"a key of more than {limits.KEY_PARTS} parts")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("values nested too deeply") from None
