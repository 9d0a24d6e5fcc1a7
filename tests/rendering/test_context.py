"""Opening a context: which driver draws, and one line that helps where none does."""

from __future__ import annotations

from typing import Any

import moderngl
import pytest

from posetrack_cli.errors import RenderingError
from posetrack_cli.rendering.gl.context import INSTALL_HINT, REQUIRED_GL, describe, open_context


def test_a_context_tells_its_driver(context: Any) -> None:
    info = describe(context)
    assert info.renderer and info.vendor
    assert context.version_code >= REQUIRED_GL
    assert str(info) == f"{info.renderer}, OpenGL {info.version}"


@pytest.mark.parametrize(("device", "where"), [(None, "OpenGL: "), (3, "OpenGL device 3: ")])
def test_no_driver_is_one_line_that_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, device: int | None, where: str
) -> None:
    asked = {}

    def fail(**options: object) -> None:
        asked.update(options)
        raise Exception("libEGL.so not loaded\nat all")

    monkeypatch.setattr(moderngl, "create_context", fail)
    with pytest.raises(RenderingError) as caught:
        open_context(device)
    line = str(caught.value)
    assert line.startswith(f"{where}no headless context, found libEGL.so not loaded at all, expected EGL")
    assert line.endswith(f"; {INSTALL_HINT}")
    assert "\n" not in line
    assert asked["backend"] == "egl"
    assert asked.get("device_index") == device


def test_a_failure_without_words_still_has_a_name(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(**_: object) -> None:
        raise ValueError

    monkeypatch.setattr(moderngl, "create_context", fail)
    with pytest.raises(RenderingError, match="found ValueError"):
        open_context()
