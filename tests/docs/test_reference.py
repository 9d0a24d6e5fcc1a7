"""``docs/reference`` is what the configurations and commands are now."""

from __future__ import annotations

import reference
from posetrack_cli.hand.config import HandConfig


def test_what_is_committed_is_current() -> None:
    pages = reference.reference_pages()
    assert {path.name for path in reference.FOLDER.iterdir()} == set(pages)
    for name, text in pages.items():
        committed = (reference.FOLDER / name).read_text(encoding="utf-8")
        assert committed == text, (
            f"docs/reference/{name} is of another version: run scripts/docs, and commit it"
        )


def test_a_key_is_told_with_type_bounds_default_and_meaning() -> None:
    page = reference.reference_pages()["hand.md"]
    assert "- `scale`: number from 0.1 to 10, default `1.0`; 1 is the average adult hand" in page
    particles = HandConfig().filter.particles
    assert f"- `particles`: whole number from 1 to 1,000,000, default `{particles}`; " in page


def test_every_command_has_its_options() -> None:
    page = reference.reference_pages()["cli.md"]
    for heading in ("posetrack batch head mono", "posetrack hand synth", "posetrack calibrate stereo"):
        assert f"\n## `{heading}`\n" in page
    assert "- `--fail-if CONDITION`: " in page
    assert "1&lt;=x&lt;=2" in page  # nothing is taken for markup
