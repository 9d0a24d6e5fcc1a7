"""Text from files, as a terminal may show it and as JSON may hold it."""

from __future__ import annotations

import json

import pytest

from posetrack_cli.text import one_line, printable, printable_json

HOSTILE = [chr(code) for code in (*range(0x20), *range(0x7F, 0xA0)) if chr(code) not in "\t\n"]
HOSTILE += ["\u061c", "\u200e", "\u200f", "\u2028", "\u2029"]
HOSTILE += [chr(code) for code in (*range(0x202A, 0x202F), *range(0x2066, 0x206A))]
HOSTILE += ["\udcff", "\udc80"]  # bytes of names that are no UTF-8


@pytest.mark.parametrize("control", HOSTILE, ids=lambda control: f"{ord(control):04x}")
def test_what_a_terminal_obeys_becomes_an_escape(control: str) -> None:
    code = f"\\x{ord(control):02x}" if ord(control) < 0x100 else f"\\u{ord(control):04x}"
    assert printable(f"a{control}b") == f"a{code}b"
    assert one_line(f"a{control}b") == f"a{code}b"


def test_other_text_stays() -> None:
    text = "a\tb ü 手 \N{NO-BREAK SPACE}\N{SOFT HYPHEN}\N{PLUS-MINUS SIGN}\\"
    assert printable(text) == one_line(text) == text


def test_only_one_line_escapes_line_feeds() -> None:
    assert printable("a\nb") == "a\nb"
    assert one_line("a\nposetrack: done") == "a\\nposetrack: done"


def test_json_means_the_same_without_controls() -> None:
    values = {f"key {''.join(HOSTILE)}": ["".join(HOSTILE), "手\n\\u202e"]}
    text = printable_json(json.dumps(values, indent=1, ensure_ascii=False))
    assert json.loads(text) == values
    assert printable(text) == text
    assert "手" in text
