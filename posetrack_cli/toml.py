"""TOML texts of strangers: what no configuration says, and costs the parser much, is refused first."""

from __future__ import annotations

import re
import tomllib
from typing import Any

from posetrack_cli import limits

_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+"""
_LONG_KEY = re.compile(rf"(?<![\w-]){_PART}(?:\.[ \t]*+{_PART}){{{limits.TOML_KEY_PARTS}}}+")


def parse_toml(text: str) -> dict[str, Any]:
    """Return what a TOML text says.

    The parser takes memory by the square of how many parts a dotted key has, 1.6 GB for a line of 40 KB, and
    recurses into what is nested.

    Raises:
        ValueError: it is no TOML, or nested more deeply than the interpreter can follow.
    """
    if _LONG_KEY.search(text):
        raise ValueError(f"a key of more than {limits.TOML_KEY_PARTS} parts")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("values nested too deeply") from error
