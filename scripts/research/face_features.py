"""Learn the appearance of the ten face points from recordings with ground truth.

Some frames of every person, also mirrored, are normalised to upright and equal size, up to the uncertainty of
an initialisation. Means and covariances of gradient histograms at and near the points give a linear
discriminant per point (``head.detection.appearance``); all people count equally. Shape modes come from
ICT-FaceKit (USC Institute for Creative Technologies, MIT licence).

A recording is an MCAP file with ground truth, for example from ``posetrack head synth``, or a folder with
left/, right/, calibration.json and truth.csv. The points of a folder are mesh vertices, which are shifted to
the visible features.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import click
import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.evaluation.reading.truth import topics_truth
from posetrack_cli.evaluation.reading.truth_tables import load_csv_track
from posetrack_cli.geometry.camera import Camera, in_camera_axes, pixels_from_points
from posetrack_cli.geometry.rigid import in_camera
from posetrack_cli.head.detection import appearance
from posetrack_cli.head.detection.responses import WIDTH, cut_patch
from posetrack_cli.head.face.points import EYES, MEAN_SHAPE, MIRRORED
from posetrack_cli.head.subject import head_subject
from posetrack_cli.losses import LossLog
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.outputs import whole_or_nothing
from posetrack_cli.recording.opening import open_recording
from research.face_model import SEEN_BESIDE, Statistics, read_statistics
from research.heads import CALIBRATION, TRUTH, cameras_of

# Frames per person and camera, patches per frame, and random seed; enough for stable weights
FRAMES, DRAWS, SEED = 24, 4, 1
# Uncertainty of size, roll and position of a face at the initialisation
SIZE_SD, ROLL_SD, SHIFT_SD_MM = 0.08, np.radians(6.0), 4.0
# Negative samples near a point: smallest and largest distance, number per frame
NEAR_PX, REACH_PX, NEIGHBOURS = 3.5, 14.0, 30
# Share of the mean variance added to every variance; covariances of few people are poor
SHRINKAGE = 0.025
# Numbers of shape modes, and RMS strength of each published expression
IDENTITY_MODES, EXPRESSION_MODES, EXPRESSION_STRENGTH = 10, 8, 0.25
DRAWN_SHARE = 0.25  # weight of a synthetic person against a rendered photographic one


class Sample(NamedTuple):
    """A patch, and its ten points (K, 2)."""

    grey: ImageArray
    points: FloatArray


class Seen(NamedTuple):
    """An image, its points (K, 2), and the scale of the face, pixels per mm."""

    image: ImageArray
    pixels: FloatArray
    scale: float


def seen_in(path: Path) -> Iterator[Seen]:
    """Yield a selection of frames of a recording for each camera."""
    for image, camera, points in _images_of_folder(path) if path.is_dir() else _images_of_file(path):
        depth = float(in_camera_axes(camera, points)[EYES, 2].mean())
        scale = float(np.sqrt(camera.fx * camera.fy)) / depth
        yield Seen(image, pixels_from_points(camera, points)[0], scale)


def _images_of_folder(path: Path) -> Iterator[tuple[ImageArray, Camera, FloatArray]]:
    cameras = cameras_of(path / CALIBRATION)
    truth = load_csv_track(path / TRUTH, head_subject(cameras[0].name, 0))
    assert truth.points is not None and truth.quaternion is not None
    for camera in cameras:
        images = sorted((path / camera.name).iterdir())
        for row in np.linspace(0, len(truth.points) - 1, FRAMES).astype(int):
            image = cv2.imread(str(images[row]), cv2.IMREAD_GRAYSCALE)
            if image is None:
                raise click.ClickException(f"{images[row]}: not an image")
            shift = in_camera(SEEN_BESIDE, np.zeros(3), truth.quaternion[row])
            yield image, camera, truth.points[row] + shift


def _images_of_file(path: Path) -> Iterator[tuple[ImageArray, Camera, FloatArray]]:
    recording = open_recording(path, "grey")
    truth = topics_truth(McapFile(path, LossLog()), head_subject(recording.cameras[0].name, 0), path.name)
    assert truth is not None and truth.points is not None
    wanted = set(np.linspace(0, len(truth.points) - 1, FRAMES).astype(int).tolist())
    for frame in recording.frames():
        row = int(np.searchsorted(truth.stamp_ns, frame.stamp_ns))
        if row not in wanted or truth.stamp_ns[row] != frame.stamp_ns:
            continue
        for camera, image in zip(recording.cameras, frame.images, strict=True):
            if image is not None:
                yield image, camera, truth.points[row]


def samples_of(seen: Seen, rng: np.random.Generator) -> Iterator[Sample]:
    """Yield patches and mirrored patches, randomly perturbed like the start of a track."""
    right, left = seen.pixels[:2].mean(axis=0), seen.pixels[2:4].mean(axis=0)
    roll = float(np.arctan2(*(left - right)[::-1]))
    for is_mirrored in (False, True) * DRAWS:
        size, turn = float(np.exp(SIZE_SD * rng.standard_normal())), ROLL_SD * rng.standard_normal()
        middle = seen.pixels[EYES].mean(axis=0) + SHIFT_SD_MM * seen.scale * rng.standard_normal(2)
        patch = cut_patch(seen.image, middle, seen.scale * size, roll + turn)
        points, grey = patch.from_image(seen.pixels), patch.grey
        if is_mirrored:
            points = np.column_stack([WIDTH - 1.0 - points[:, 0], points[:, 1]])[list(MIRRORED)]
            grey = np.ascontiguousarray(grey[:, ::-1])
        yield Sample(grey, points)


TAPS_AT = appearance.SPACING * (np.arange(appearance.TAPS) - appearance.TAPS // 2)


def described(picture: Float32Array, places: FloatArray) -> FloatArray:
    """Return the histograms (n, BINS * TAPS * TAPS) around pixels (n, 2)."""
    x, y = np.rint(places).astype(int).T
    rows = np.clip(y[:, None] + TAPS_AT, 0, picture.shape[1] - 1)[:, :, None]
    columns = np.clip(x[:, None] + TAPS_AT, 0, picture.shape[2] - 1)[:, None, :]
    found: FloatArray = np.moveaxis(picture[:, rows, columns], 0, 1).astype(np.float64)
    return found.reshape(len(places), -1)


class Moments(NamedTuple):
    """First and second moments of histograms: mean (D,), mean outer product (D, D)."""

    mean: FloatArray
    square: FloatArray

    @property
    def covariance(self) -> FloatArray:
        """Covariance (D, D)."""
        covariance: FloatArray = self.square - np.outer(self.mean, self.mean)
        return covariance


class PointMoments(NamedTuple):
    """Moments at a point, and at places near it."""

    at: Moments
    near: Moments

    def discriminant(self) -> tuple[FloatArray, float]:
        """Return w (D,) and b of the log-odds, linearised between the means of two normal scores."""
        covariance = 0.5 * (self.at.covariance + self.near.covariance)
        shrunk = covariance + SHRINKAGE * np.trace(covariance) / len(covariance) * np.eye(len(covariance))
        w = np.linalg.solve(shrunk, self.at.mean - self.near.mean)
        at, near = float(self.at.mean @ w), float(self.near.mean @ w)
        gain = (at - near) / float(w @ covariance @ w)
        return gain * w, -gain * 0.5 * (at + near)


def moments_of(path: Path) -> tuple[PointMoments, ...]:
    """Return the moments of a person's points of the right side."""
    # A seed per person: leaving out a person must not change the samples of the others.
    rng = np.random.default_rng(SEED)
    at: list[list[FloatArray]] = [[] for _ in appearance.RIGHT_SIDE]
    near: list[list[FloatArray]] = [[] for _ in appearance.RIGHT_SIDE]
    for sample in (sample for seen in seen_in(path) for sample in samples_of(seen, rng)):
        picture = appearance.histograms(sample.grey)
        for k, seen_at, seen_near in zip(appearance.RIGHT_SIDE, at, near, strict=True):
            places = rng.uniform(-REACH_PX, REACH_PX, (3 * NEIGHBOURS, 2))
            places = places[np.linalg.norm(places, axis=1) > NEAR_PX][:NEIGHBOURS]
            seen_at.append(described(picture, sample.points[k : k + 1]))
            seen_near.append(described(picture, sample.points[k] + places))
    return tuple(PointMoments(moments(one), moments(other)) for one, other in zip(at, near, strict=True))


def pooled(people: Sequence[Moments], counts: Sequence[float]) -> Moments:
    """Return the weighted mean of the moments of people."""
    shares = np.array(counts) / np.sum(counts)
    return Moments(*(np.tensordot(shares, np.stack(part), axes=1) for part in zip(*people, strict=True)))


def learn(people: Sequence[tuple[tuple[PointMoments, ...], float]]) -> tuple[Float32Array, FloatArray]:
    """Return weights (K / 2, BINS, TAPS, TAPS) and constants (K / 2,) of the points of the right side."""
    weights, constants, counts = [], [], [counts for _, counts in people]
    for k in range(len(appearance.RIGHT_SIDE)):
        at = pooled([points[k].at for points, _ in people], counts)
        near = pooled([points[k].near for points, _ in people], counts)
        w, b = PointMoments(at, near).discriminant()
        weights.append(w.reshape(appearance.BINS, appearance.TAPS, appearance.TAPS).astype(np.float32))
        constants.append(b)
    return np.stack(weights), np.array(constants)


def moments(values: Sequence[FloatArray]) -> Moments:
    """Return the moments of several arrays of histograms (n, D)."""
    rows = np.concatenate(values)
    return Moments(rows.mean(axis=0), rows.T @ rows / len(rows))


def shape_modes(statistics: Statistics) -> FloatArray:
    """Return (M, K, 3) mm: identity modes, then principal components of random expressions."""
    moved = []
    for name, displacement in statistics.expressions.items():
        one = EXPRESSION_STRENGTH * displacement
        if name in ("mouthLeft", "mouthRight"):  # nostril vertices move, the visible openings do not
            one[6:8] = 0.0
        moved.append(one.ravel())
    values, vectors = np.linalg.eigh(np.array(moved).T @ np.array(moved))
    best = np.argsort(-values)[:EXPRESSION_MODES]
    expressions = (vectors[:, best] * np.sqrt(values[best])).T.reshape(-1, *MEAN_SHAPE.shape)
    modes: FloatArray = np.concatenate([statistics.modes[:IDENTITY_MODES], expressions])
    return modes


@click.command(help=__doc__)
@click.argument("statistics", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("recordings", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.option("--without", multiple=True, help="Leave out the recording of this name. Repeatable.")
@click.option("--out", default=appearance.SHIPPED, type=click.Path(dir_okay=False, path_type=Path))
def main(statistics: Path, recordings: tuple[Path, ...], without: tuple[str, ...], out: Path) -> None:
    """Write the appearance model."""
    used = [path for path in recordings if path.name not in without]
    weights, constants = learn([(moments_of(path), 1.0 if path.is_dir() else DRAWN_SHARE) for path in used])
    arrays = {
        "constants": constants.round(4),
        "shape_modes": shape_modes(read_statistics(statistics)).round(3),
        "weights": weights.round(4),
    }
    stream = BytesIO()
    np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
    with whole_or_nothing(out) as part:
        part.write_bytes(stream.getvalue())
    mirror = float(
        np.abs(appearance.mirrored_weights(appearance.mirrored_weights(weights[0])) - weights[0]).max()
    )
    print(f"{out}: {len(used)} people, mirror {mirror:g}")


if __name__ == "__main__":
    main()
