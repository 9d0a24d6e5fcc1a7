"""Response maps on drawn features whose places are known."""

from __future__ import annotations

import cv2
import numpy as np

from posetrack_cli.head.detection.responses import HEIGHT, WIDTH, arc, bar, disc, response_maps, wedge
from posetrack_cli.head.face.points import MIRRORED, POINT_COUNT

SKIN, DARK = 170.0, 60.0


def drawn(*features: tuple[np.ndarray, int, int]) -> np.ndarray:
    """Skin with dark templates drawn about places (x, y), and a little noise."""
    patch = np.random.default_rng(1).normal(SKIN, 1.0, (HEIGHT, WIDTH))
    for template, x, y in features:
        half_y, half_x = template.shape[0] // 2, template.shape[1] // 2
        part = patch[y - half_y : y + half_y + 1, x - half_x : x + half_x + 1]
        part -= (SKIN - DARK) * (1.0 - template)
    return np.clip(np.rint(patch), 0, 255).astype(np.uint8)


def strongest(response: np.ndarray) -> tuple[int, int]:
    row, column = np.unravel_index(int(np.argmax(response)), response.shape)
    return int(column), int(row)


def near(place: tuple[int, int], x: int, y: int) -> bool:
    return abs(place[0] - x) <= 2 and abs(place[1] - y) <= 2


def test_an_eyes_corners_are_where_wedges_have_their_tips() -> None:
    maps = response_maps(drawn((wedge(1), 60, 75), (wedge(-1), 150, 75)))
    assert near(strongest(maps[0]), 60, 75)  # the right eye's outer corner opens to the right of the image
    assert near(strongest(maps[3]), 150, 75)


def test_a_brow_is_where_a_bar_ends_and_a_nostril_where_a_disc_is() -> None:
    maps = response_maps(drawn((bar(-1, 3.0), 95, 55), (disc(), 100, 120)))
    assert near(strongest(maps[8]), 95, 55)
    nostril = maps[6][110:130, 85:115]
    assert near(strongest(nostril), 15, 10)


def test_a_noses_base_is_where_an_arc_is() -> None:
    maps = response_maps(drawn((arc(), 110, 115)))
    assert near(strongest(maps[POINT_COUNT]), 110, 115)


def test_a_mirrored_face_has_mirrored_maps() -> None:
    patch = cv2.GaussianBlur(np.random.default_rng(2).integers(0, 255, (HEIGHT, WIDTH), np.uint8), (0, 0), 3)
    patch = cv2.normalize(patch, None, 0, 255, cv2.NORM_MINMAX)
    maps, mirrored = response_maps(patch), response_maps(np.ascontiguousarray(patch[:, ::-1]))
    pairs = [*MIRRORED, POINT_COUNT]
    # float32 correlations, summed in another order; roots of small values magnify the difference
    np.testing.assert_allclose(mirrored[pairs], maps[:, :, ::-1], atol=5e-3)
