"""TOML of strangers: what would exhaust the parser is refused, and nothing that a configuration says."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import pytest

from posetrack_cli.limits import TOML_KEY_PARTS
from posetrack_cli.toml import parse_toml

LONG = 20_000


@pytest.mark.parametrize(
    "text",
    [
        "a" + ".a" * LONG + " = 1",
        "[a" + ".a" * LONG + "]",
        "[[a" + " . a" * LONG + "]]",
        'x = {a."b c"' + ".'d'" * LONG + " = 1}",
    ],
    ids=["key", "table", "array", "inline"],
)
def test_a_key_of_many_parts_is_refused_before_it_takes_memory(text: str) -> None:
    tracemalloc.start()
    with pytest.raises(ValueError, match=f"more than {TOML_KEY_PARTS} parts"):
        parse_toml(text)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 50 * len(text)  # tomllib takes a pointer for every part of every beginning of the key


@pytest.mark.parametrize("text", ["x = " + "[" * LONG, "x = " + "{a=" * LONG], ids=["arrays", "tables"])
def test_deep_nesting_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="nested"):
        parse_toml(text)


def test_what_configurations_say_is_taken() -> None:
    parts = ".".join("abcd")
    values = [f'{parts} = "{"../" * 40}x.y.z"', "# " + ". " * 100, "n = [" + "1.5, " * 1000 + "]"]
    parsed = parse_toml("\n".join(values))
    assert parsed["a"]["b"]["c"]["d"].endswith("x.y.z") and len(parsed["n"]) == 1000
    for path in (Path(__file__).parents[1] / "configs").glob("*.toml"):
        assert parse_toml(path.read_text())


@pytest.mark.parametrize("text", ["a" * 10**6, "a." * 10**6, '"' * 10**6, "- " * 10**6], ids=lambda t: t[:2])
def test_looking_for_long_keys_ends(text: str) -> None:
    """By the square of the length it would take hours."""
    with pytest.raises(ValueError):
        parse_toml(text)
