"""The text of a shader, with the constants that the program which loads it sets."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources


def shader_source(name: str, defines: Mapping[str, int]) -> str:
    """Return a file of ``shaders``, each define a line after its version line."""
    source = resources.files(__package__).joinpath("shaders", name).read_text(encoding="utf-8")
    version, rest = source.split("\n", 1)
    return "\n".join([version, *(f"#define {key} {value}" for key, value in defines.items()), rest])
