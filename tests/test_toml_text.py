"""TOML that is no TOML, or would take without end, is one error."""

from __future__ import annotations

import pytest

from posetrack_cli.text import parse_toml


@pytest.mark.parametrize(
    "text",
    [
        "x = " + "[" * 100_000,
        "a." * 20_000 + "b = 1",
        "[" + "a." * 20_000 + "b]",
        "x = {" + '"a" . ' * 20_000 + "b = 1}",
        "x = " + "9" * 5000,
        "\x00",
    ],
)
def test_hostile_text_is_one_error(text: str) -> None:
    with pytest.raises(ValueError, match=r"^[^\n]+$"):
        parse_toml(text)


def test_text_with_many_points_is_no_key() -> None:
    text = f'[a.b]\nx = "{"a." * 100}b"  # {"." * 100}\n'
    assert parse_toml(text)["a"]["b"]["x"].endswith("a.b")
