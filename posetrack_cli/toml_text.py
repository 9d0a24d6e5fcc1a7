"""TOML from strangers: whatever is wrong with it is one kind of error, and takes no time without end."""

from __future__ import annotations

import re
import tomllib
from typing import Any

from posetrack_cli import limits

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
