"""Untrusted text: escaped for printing, and parsed as TOML in bounded time.

Terminals interpret control characters, and bidirectional controls can disguise text.
"""

from __future__ import annotations

import re
import tomllib
from typing import Any

from posetrack_cli import limits

# C0 except tab and line feed, DEL, C1; bidirectional marks, embeddings, overrides and isolates; line and
# paragraph separators, which some viewers show as line feeds; surrogates, which Python uses for bytes of file
# names that are not UTF-8.
_CONTROLS = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]"
)


def printable(text: str) -> str:
    """Return text with control characters escaped as in ``\\x1b``; tabs and line feeds stay."""
    return _CONTROLS.sub(_escape, text)


def one_line(text: str) -> str:
    """Return printable text with line feeds escaped, so that a name cannot start a new line."""
    return printable(text).replace("\n", "\\n")


def printable_json(text: str) -> str:
    """Return equivalent JSON without control characters in its strings."""
    return _CONTROLS.sub(lambda found: f"\\u{ord(found.group()):04x}", text)


def _escape(found: re.Match[str]) -> str:
    code = ord(found.group())
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"


_PART = r"""(?:[A-Za-z0-9_-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*"""
_DEEP_KEY = re.compile(rf"(?:^[ \t\[]*|[{{,][ \t]*){_PART * limits.KEY_PARTS}", re.MULTILINE)


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML text.

    Raises:
        ValueError: it is not TOML, is nested too deeply, or has integers of thousands of digits.
    """
    if _DEEP_KEY.search(text):  # tomllib needs seconds for a dotted key of a few kilobytes
        raise ValueError(f"a key has more than {limits.KEY_PARTS} parts")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("values nested too deeply") from None
