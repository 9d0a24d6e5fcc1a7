"""Opening a device: which driver draws, and one line that helps where none does."""

from __future__ import annotations

import moderngl
import pytest

from posetrack_cli.errors import RenderingError
from posetrack_cli.rendering.devices import device_or_default, open_device
from posetrack_cli.rendering.gl.device import INSTALL_HINT, REQUIRED_GL, GlDevice


def test_a_device_tells_its_driver(device: GlDevice) -> None:
    info = device.info
    assert info.renderer and info.vendor
    assert device.context.version_code >= REQUIRED_GL
    assert info.version.startswith("OpenGL ")
    assert str(info) == f"{info.renderer}, {info.version}"


@pytest.mark.parametrize(("index", "where"), [(None, "OpenGL: "), (3, "OpenGL device 3: ")])
def test_no_driver_is_one_line_that_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, index: int | None, where: str
) -> None:
    asked = {}

    def fail(**options: object) -> None:
        asked.update(options)
        raise Exception("libEGL.so not loaded\nat all")

    monkeypatch.setattr(moderngl, "create_context", fail)
    with pytest.raises(RenderingError) as caught:
        open_device(index)
    line = str(caught.value)
    assert line.startswith(f"{where}no headless context, found libEGL.so not loaded at all, expected EGL")
    assert line.endswith(f"; {INSTALL_HINT}")
    assert "\n" not in line
    assert asked["backend"] == "egl"
    assert asked.get("device_index") == index


def test_a_failure_without_words_still_has_a_name(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(**_: object) -> None:
        raise ValueError

    monkeypatch.setattr(moderngl, "create_context", fail)
    with pytest.raises(RenderingError, match="found ValueError"):
        open_device()


def test_a_given_device_is_left_open_and_an_own_one_closed(
    device: GlDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed: list[GlDevice] = []
    close = GlDevice.close
    monkeypatch.setattr(GlDevice, "close", lambda self: (closed.append(self), close(self)))
    with device_or_default(device) as given:
        assert given is device
    assert not closed
    with device_or_default(None) as own:
        assert own is not device
    assert closed == [own]
