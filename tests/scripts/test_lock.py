"""What scripts/setup installs: both requirements files pin all that is needed, with hashes."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
HINT = "run scripts/lock, and commit what it writes"


def pins(*names: str) -> dict[str, str]:
    """Versions that are installed here, by distribution; every entry has hashes."""
    found: dict[str, str] = {}
    for name in names:
        text = "\n".join(line for line in (ROOT / name).read_text().splitlines() if not line.startswith("#"))
        for entry in text.replace("\\\n", "").splitlines():
            line, *hashes = entry.split("--hash=sha256:")
            assert hashes and all(re.fullmatch(r"[0-9a-f]{64} *", one) for one in hashes), entry
            pin = Requirement(line)
            if pin.marker is None or pin.marker.evaluate():
                assert canonicalize_name(pin.name) not in found or name != "requirements.txt"
                found[canonicalize_name(pin.name)] = str(pin.specifier).removeprefix("==")
    return found


def unmet(required: Iterator[str], pinned: dict[str, str]) -> list[str]:
    """Requirements of this platform that no pin meets; extras are asked for by name."""
    here = [one for one in map(Requirement, required) if not one.marker or one.marker.evaluate({"extra": ""})]
    return [str(one) for one in here if pinned.get(canonicalize_name(one.name), "0") not in one.specifier]


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
RUNS = [*PROJECT["build-system"]["requires"], *PROJECT["project"]["dependencies"]]
EXTRAS = PROJECT["project"]["optional-dependencies"]


def test_what_runs_is_pinned_apart_from_what_development_adds() -> None:
    assert not unmet(iter(RUNS), pins("requirements.txt")), HINT
    every = pins("requirements.txt", "requirements-dev.txt")
    assert not unmet(iter([*RUNS, *EXTRAS["dev"], *EXTRAS["c3d"]]), every), HINT
    batch = pins("requirements.txt", "requirements-batch.txt")
    assert not unmet(iter([*RUNS, *EXTRAS["batch"]]), batch), HINT
    assert all(every.get(name, version) == version for name, version in batch.items()), HINT
    assert "pytest" not in pins("requirements.txt")


@pytest.mark.parametrize(
    "names",
    [
        ("requirements.txt",),
        ("requirements.txt", "requirements-dev.txt"),
        ("requirements.txt", "requirements-batch.txt"),
    ],
)
def test_pins_are_closed_since_pip_looks_for_nothing_else(names: tuple[str, ...]) -> None:
    """scripts/setup installs them with --no-deps."""
    pinned = pins(*names)

    def needed() -> Iterator[str]:
        for name in pinned:
            try:
                yield from requires(name) or ()
            except PackageNotFoundError:  # not of this environment
                continue

    assert not unmet(needed(), pinned), HINT
