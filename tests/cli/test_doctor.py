"""``posetrack doctor``: each renderer once, and what is missing if there is none."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from posetrack_cli.cli.doctor import LIBRARIES
from posetrack_cli.cli.main import run
from posetrack_cli.errors import RenderingError
from posetrack_cli.rendering import devices
from posetrack_cli.rendering.port import RendererInfo

SMALL = ["doctor", "--particles", "16"]


class FakeDevice:
    """Knows its name; counts how many are open."""

    opened = 0

    def __init__(self, index: int | None) -> None:
        name = "default" if index is None else f"card {index}"
        self.info = RendererInfo(name, "nobody", "OpenGL 4.5")
        FakeDevice.opened += 1

    def close(self) -> None:
        FakeDevice.opened -= 1


def with_devices(monkeypatch: pytest.MonkeyPatch, numbers: set[int], default: bool = True) -> None:
    """Let EGL have these devices, and a default one or not."""

    def open_fake(index: int | None = None) -> Any:
        if index in numbers or (index is None and default):
            return FakeDevice(index)
        raise RenderingError("no headless context", where=f"OpenGL device {index}")

    monkeypatch.setattr(devices, "open_device", open_fake)
    monkeypatch.setattr("posetrack_cli.cli.doctor._scoring_times", lambda device, particles: [(64, 1.0)])


def drawn_with(capsys: pytest.CaptureFixture[str]) -> list[str]:
    out = capsys.readouterr().out
    return [line.removeprefix("OpenGL ") for line in out.splitlines() if line.startswith("OpenGL ")]


def test_names_and_measures_the_real_renderer(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(SMALL) == 0
    out = capsys.readouterr().out
    for drawn in ("Processor: ", "OpenGL default: "):
        assert "16 particles, 64x64 pixels each" in out.split(drawn)[1].splitlines()[1]


def test_every_library_that_posetrack_needs_is_told() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    assert {re.split("[<>=]", name)[0] for name in project["dependencies"]} == set(LIBRARIES)


def test_a_single_device_is_told_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with_devices(monkeypatch, {0})
    assert run(SMALL) == 0
    assert drawn_with(capsys) == ["default: default, OpenGL 4.5"]
    assert FakeDevice.opened == 0


def test_several_devices_are_all_told_also_beyond_one_that_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with_devices(monkeypatch, {0, 2})
    assert run(SMALL) == 0
    assert [line.split(",")[0] for line in drawn_with(capsys)] == [
        "default: default",
        "device 0: card 0",
        "device 2: card 2",
    ]


def test_one_device_can_be_asked_for(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with_devices(monkeypatch, {0, 1})
    assert run([*SMALL, "--device", "1"]) == 0
    assert drawn_with(capsys) == ["device 1: card 1, OpenGL 4.5"]


def test_a_device_that_works_is_told_when_the_default_does_not(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with_devices(monkeypatch, {1}, default=False)
    assert run(SMALL) == 1
    assert drawn_with(capsys) == ["default: does not work", "device 1: card 1, OpenGL 4.5"]


def test_a_device_is_closed_when_measuring_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(device: Any, particles: int) -> Iterator[tuple[int, float]]:
        raise RenderingError("tile is too large for this GL")

    with_devices(monkeypatch, {0})
    monkeypatch.setattr("posetrack_cli.cli.doctor._scoring_times", fail)
    assert run([*SMALL, "--device", "0"]) == 1
    assert FakeDevice.opened == 0
    assert drawn_with(capsys) == ["device 0: card 0, OpenGL 4.5", "device 0: does not work"]


def test_each_check_is_told_before_the_next_begins(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said: list[str] = []

    def times(device: Any, particles: int) -> Iterator[tuple[int, float]]:
        for tile in (64, 128):
            said.append(capsys.readouterr().out)
            yield tile, 1.0

    with_devices(monkeypatch, {0})
    monkeypatch.setattr("posetrack_cli.cli.doctor._scoring_times", times)
    assert run([*SMALL, "--device", "0"]) == 0
    assert said[0].endswith("OpenGL device 0: card 0, OpenGL 4.5\n")
    assert said[1] == "  16 particles, 64x64 pixels each: 1.0 ms\n"
