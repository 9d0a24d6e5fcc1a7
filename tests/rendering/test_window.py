"""Windows: which image pixels a tile samples, and where points fall in it."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from posetrack_cli.rendering.port import Window
from support.rendering import CAMERA

windows = st.builds(
    Window,
    st.integers(-100, 100),
    st.integers(-100, 100),
    st.integers(1, 5),
    st.integers(1, 64),
    st.integers(1, 64),
)
ROUNDING_PX = 1e-9


@settings(deadline=None)
@given(windows, st.floats(-300, 300), st.floats(-300, 300), st.floats(50, 2000))
def test_a_point_falls_on_the_tile_where_its_pixel_lies(w: Window, x: float, y: float, z: float) -> None:
    a, b, c, d = w.tile_projection(CAMERA)
    (u, v), _ = CAMERA.pixels_from_points(np.array([x, y, z]))
    # tile pixel i shows image column left + i step, and spans i..i+1 with its centre at a half
    assert abs(w.left + (a * x / z + b - 0.5) * w.step - u) < ROUNDING_PX
    assert abs(w.top + (c * y / z + d - 0.5) * w.step - v) < ROUNDING_PX


@settings(deadline=None)
@given(windows)
def test_columns_and_rows_are_steps_about_the_centre(w: Window) -> None:
    assert w.columns().tolist() == [w.left + i * w.step for i in range(w.width)]
    assert w.rows().tolist() == [w.top + j * w.step for j in range(w.height)]
    np.testing.assert_allclose(w.centre, [w.columns().mean(), w.rows().mean()])


@settings(deadline=None)
@given(st.floats(-500, 500), st.floats(-500, 500), st.integers(1, 128), st.integers(1, 4))
def test_a_window_is_around_its_pixel(u: float, v: float, size: int, step: int) -> None:
    w = Window.around(np.array([u, v]), size, step)
    assert (w.width, w.height, w.step) == (size, size, step)
    assert np.abs(w.centre - [u, v]).max() <= 0.5 + ROUNDING_PX  # windows lie on whole pixels


def test_the_whole_image() -> None:
    w = Window.whole(CAMERA)
    assert (w.columns()[[0, -1]].tolist(), w.rows()[[0, -1]].tolist()) == ([0, 63], [0, 47])
    assert w.tile_projection(CAMERA) == (90.0, 31.2 + 0.5, 95.0, 24.7 + 0.5)
