"""Prior of the focal length and of the principal point."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.lens.prior import centre_prior, is_crop, log_focal_lengths, log_prior


def mean(eye_distance: float, *, crop: bool = False) -> float:
    u = log_focal_lengths()
    density = np.exp(log_prior(u, eye_distance, is_crop=crop))
    return float(np.exp(density @ u / density.sum()))


def image(width: int, height: int) -> Camera:
    return Camera(width, height, 1000.0, 1000.0, width / 2, height / 2)


def test_a_face_that_fills_the_image_is_seen_through_a_long_lens() -> None:
    # 63 mm are 0.25 of the image: at 53 degrees the face would be 25 cm away
    near, usual, far = (mean(share) for share in (0.25, 0.1, 0.03))
    assert near > 1.4 * usual > 1.4 * far
    assert 63.0 * near / 0.25 > 400.0
    assert 0.8 < usual < 1.1  # an ordinary webcam at 0.6 m


def test_without_a_face_the_field_of_view_alone_counts() -> None:
    assert mean(np.nan) < mean(np.nan, crop=True)


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        ((640, 480), False),
        ((1080, 1920), False),
        ((512, 512), True),
        ((431, 377), True),
        ((1920, 1072), True),
    ],
)
def test_sizes_that_no_camera_records_are_crops(size: tuple[int, int], expected: bool) -> None:
    assert is_crop(image(*size)) == expected


def test_the_principal_point_of_a_crop_is_less_certain_the_smaller_the_part() -> None:
    def spread(camera: Camera, focal: float) -> float:
        places, log_density = centre_prior(camera, np.log(focal))
        return float(places[-1] * np.exp(log_density[len(places) // 4]))  # widest and heaviest tails

    whole, half, tenth = (
        spread(camera, f)
        for camera, f in ((image(640, 480), 1.0), (image(500, 500), 2.0), (image(500, 500), 10.0))
    )
    assert whole < half < tenth


def test_a_stated_focal_length_is_believed_unless_the_image_is_a_crop_at_an_odd_distance() -> None:
    u = log_focal_lengths()

    def moments(stated: float, eye_distance: float, *, crop: bool) -> tuple[float, float]:
        density = np.exp(log_prior(u, eye_distance, is_crop=crop, stated=stated))
        density /= density.sum()
        centre = density @ u
        return float(np.exp(centre)), float(np.sqrt(density @ (u - centre) ** 2))

    focal, sd = moments(0.75, 0.1, crop=False)
    assert focal == pytest.approx(0.75, rel=0.03) and sd < 0.1
    # the face would be 19 cm away
    focal, sd = moments(0.75, 0.25, crop=True)
    assert focal > 1.2 and sd > 0.3
