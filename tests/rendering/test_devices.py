"""Which device a run draws on."""

from __future__ import annotations

from typing import Any

import pytest

from posetrack_cli.errors import RenderingError
from posetrack_cli.rendering import devices
from posetrack_cli.rendering.cpu import CpuDevice
from posetrack_cli.rendering.devices import CPU, open_fastest_device, open_usual_device
from posetrack_cli.rendering.port import RendererInfo


class FakeGl:
    """An OpenGL device of some name."""

    def __init__(self, name: str) -> None:
        self.info, self.closed = RendererInfo(name, "nobody", "OpenGL 4.6"), False

    def close(self) -> None:
        self.closed = True


def with_machine(monkeypatch: pytest.MonkeyPatch, gpu: bool, renderer: str | None) -> list[Any]:
    """Let a machine have a GPU or not, and an OpenGL of some name or none; return what is opened."""
    opened: list[Any] = []

    def open_fake(index: int | None = None) -> Any:
        if renderer is None:
            raise RenderingError("no headless context", where="OpenGL")
        opened.append(FakeGl(renderer if index is None else f"card {index}"))
        return opened[-1]

    monkeypatch.setattr(devices, "_has_gpu", lambda: gpu)
    monkeypatch.setattr(devices, "open_device", open_fake)
    return opened


def test_a_gpu_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = with_machine(monkeypatch, True, "NVIDIA H200/PCIe/SSE2")
    assert open_fastest_device() is opened[0]
    assert not opened[0].closed


@pytest.mark.parametrize("renderer", ["llvmpipe (LLVM 15.0.6, 256 bits)", "softpipe", None])
def test_opengl_without_a_gpu_is_not(renderer: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = with_machine(monkeypatch, True, renderer)
    assert isinstance(open_fastest_device(), CpuDevice)
    assert all(device.closed for device in opened)


def test_without_a_gpu_opengl_is_not_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = with_machine(monkeypatch, False, "NVIDIA H200/PCIe/SSE2")
    assert isinstance(open_fastest_device(), CpuDevice)
    assert opened == []


def test_what_is_chosen_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    with_machine(monkeypatch, True, "NVIDIA H200/PCIe/SSE2")
    assert isinstance(open_fastest_device(CPU), CpuDevice)
    assert open_fastest_device(3).info.renderer == "card 3"
    with_machine(monkeypatch, True, None)
    with pytest.raises(RenderingError, match="no headless context"):
        open_fastest_device(0)


def test_pictures_are_drawn_by_the_driver_and_without_one_by_the_processor(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    opened = with_machine(monkeypatch, False, "llvmpipe")
    assert open_usual_device() is opened[0] and not opened[0].closed
    assert isinstance(open_usual_device(CPU), CpuDevice)
    assert open_usual_device(3).info.renderer == "card 3"
    with_machine(monkeypatch, False, None)
    assert isinstance(open_usual_device(), CpuDevice)
    with pytest.raises(RenderingError, match="no headless context"):
        open_usual_device(0)


def test_the_processor_opens_opengl_once_for_textured_surfaces(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[FakeGl] = []

    class Drawing(FakeGl):
        def __init__(self) -> None:
            super().__init__("llvmpipe")
            opened.append(self)

        def surface_renderer(self, *_: object) -> Drawing:
            return self

    monkeypatch.setattr("posetrack_cli.rendering.gl.device.GlDevice", Drawing)
    device = CpuDevice()
    assert opened == []
    first, second = (device.surface_renderer((8, 8), [], 1) for _ in range(2))
    assert first is second and len(opened) == 1
    device.close()
    assert opened[0].closed
