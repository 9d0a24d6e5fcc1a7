"""Faces and their points in images of people."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from posetrack_cli import limits
from posetrack_cli.errors import PosetrackError, UsageError
from posetrack_cli.head.config import DetectionSettings
from posetrack_cli.head.detection.detector import CERTAIN, FaceDetector
from posetrack_cli.head.detection.finders import FaceGuess, HaarFaces, YunetFaces
from posetrack_cli.head.detection.search import ROTATIONS, SearchedImage, Way
from posetrack_cli.head.face.points import EYES, MIRRORED

# The detector's points lie within these of the truth's vertices, mm, once each point's constant offset is
# off: medians over frames, of the worst point of a kind.
REPEATED_MM = {"eyes": 2.0, "mouth": 2.5, "nose": 4.0, "brows": 5.0}


def grey(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    return image


def clip_frame(path: Path, index: int) -> np.ndarray:
    video = cv2.VideoCapture(str(path))
    video.set(cv2.CAP_PROP_POS_FRAMES, index)
    found, image = video.read()
    assert found
    return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def truth_of(person: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (N, 3), rotations (N, 3, 3) and points in the head's frame (N, K, 3)."""
    from posetrack_cli.geometry.rotations import matrices_from_quaternions

    table = np.loadtxt(person / "truth.csv", delimiter=",", skiprows=1)
    return table[:, 1:4], matrices_from_quaternions(table[:, 4:8]), table[:, 8:].reshape(len(table), -1, 3)


@pytest.mark.parametrize("person", ["person-a", "person-b"])
def test_points_repeat_in_the_heads_frame(measured_data: Path, person: str) -> None:
    folder = measured_data / "heads" / person
    positions, rotations, shapes = truth_of(folder)
    detector, offsets = FaceDetector(), []
    for i in range(0, len(positions), 30):
        faces = detector.detect(grey(folder / "left" / f"{i:06d}.jpg")).faces
        assert len(faces) == 1
        points = shapes[i] @ rotations[i].T + positions[i]
        pixels = 1000.0 * points[:, :2] / points[:, 2:] + [320.0, 240.0]
        off = np.zeros_like(points)
        off[:, :2] = (faces[0].pixels - pixels) * points[:, 2:] / 1000.0
        offsets.append((off @ rotations[i])[:, :2])
    spread = np.linalg.norm(np.array(offsets) - np.median(offsets, axis=0), axis=2)
    medians = np.median(spread, axis=0)
    kinds = {"eyes": medians[:4], "mouth": medians[4:6], "nose": medians[6:8], "brows": medians[8:]}
    assert all(values.max() < REPEATED_MM[kind] for kind, values in kinds.items()), kinds


@pytest.mark.parametrize(
    ("clip", "index"), [("clip-a", 30), ("clip-a", 210), ("clip-b", 30), ("clip-b", 390)]
)
def test_haar_and_yunet_lead_to_the_same_points(measured_data: Path, clip: str, index: int) -> None:
    image = clip_frame(measured_data / "faces" / f"{clip}.mp4", index)
    model = str(measured_data / "faces" / "face_detection_yunet_2023mar.onnx")
    by_haar = FaceDetector().detect(image)
    by_yunet = FaceDetector(DetectionSettings(detector="yunet", model=model)).detect(image)
    assert len(by_haar.faces) == len(by_yunet.faces) == 1
    one, other = by_haar.faces[0].pixels, by_yunet.faces[0].pixels
    eye_distance = np.hypot(*(one[2:4].mean(axis=0) - one[:2].mean(axis=0)))
    # Two starts of one search: the median point agrees to a few hundredths of the eyes' distance.
    assert np.median(np.linalg.norm(one - other, axis=1)) < 0.05 * eye_distance


def test_a_mirrored_face_has_mirrored_points(measured_data: Path) -> None:
    image = grey(measured_data / "heads" / "person-b" / "left" / "000000.jpg")
    (face,) = FaceDetector().detect(image).faces
    (mirrored,) = FaceDetector().detect(np.ascontiguousarray(image[:, ::-1])).faces
    back = mirrored.pixels[list(MIRRORED)] * [-1.0, 1.0] + [image.shape[1] - 1.0, 0.0]
    distances = np.linalg.norm(back - face.pixels, axis=1)
    assert np.median(distances[EYES]) < 2.0  # the cascades are not symmetric, the points nearly are
    assert np.median(distances) < 3.0


LEARNED = DetectionSettings(points="learned", least_point_score=0.6)


class TrueAndFalse:
    """Finds the face at a place only when searched again, and a larger one in the background before."""

    def __init__(self, true: FaceGuess, *others: FaceGuess, again: bool) -> None:
        self._found, self._later = (others, (true,)) if again else ((*others, true), ())

    def find(self, image: np.ndarray, scale: float = 1.0) -> tuple[FaceGuess, ...]:
        return self._found

    def find_turned(self, image: np.ndarray, scale: float = 1.0) -> tuple[FaceGuess, ...]:
        return ()

    def find_again(self, image: np.ndarray, scale: float = 1.0) -> tuple[FaceGuess, ...]:
        return self._later


@pytest.mark.parametrize("again", [False, True])
def test_a_face_counts_before_a_larger_doubtful_one_and_is_searched_twice(
    measured_data: Path, monkeypatch: pytest.MonkeyPatch, again: bool
) -> None:
    """The second detection lies at the chin, where points do not look like a face's."""
    image = grey(measured_data / "heads" / "person-b" / "left" / "000000.jpg")
    detector = FaceDetector(LEARNED)
    (usual,) = detector.detect(image).faces
    assert usual.score > CERTAIN
    chin = usual.guess.middle + np.array([0.0, 2.0 * usual.guess.eye_distance])
    large = FaceGuess(chin, 1.5 * usual.guess.eye_distance, 0.0, 0.9)
    monkeypatch.setattr(detector, "_finder", TrueAndFalse(usual.guess, large, again=again))
    first = detector.detect(image).faces[0]
    np.testing.assert_allclose(first.pixels, usual.pixels, atol=1.0)
    corners = FaceDetector()  # as printed: one search
    monkeypatch.setattr(corners, "_finder", TrueAndFalse(usual.guess, again=True))
    assert corners.detect(image).faces == ()


def test_where_no_face_is_none_is_found() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (240, 320), np.uint8)
    detection = FaceDetector().detect(cv2.GaussianBlur(noise, (0, 0), 4))
    assert detection.faces == ()
    assert detection.best_score < 0.5


def test_of_thousands_of_faces_the_surest_are_kept() -> None:
    """Points would be looked for in each, which takes milliseconds a face."""
    rng = np.random.default_rng(0)
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(64), np.arange(32)))
    rows = np.zeros((len(x), 15), np.float32)
    rows[:, 4:14] = (rows[:, None, :2] + [[0, 0], [4, 0], [2, 2], [0, 4], [4, 4]]).reshape(len(x), 10)
    rows[:, 4:14:2] += 5.0 * x[:, None]
    rows[:, 5:14:2] += 5.0 * y[:, None]
    rows[:, 14] = rng.random(len(x))

    class Network:
        def setInputSize(self, size: tuple[int, int]) -> None:
            pass

        def detect(self, image: object) -> tuple[int, object]:
            return 1, rows

    finder = object.__new__(YunetFaces)
    finder._network, finder._model = Network(), Path("model.onnx")  # type: ignore[assignment]
    found = finder.find(np.zeros((200, 320), np.uint8))
    assert len(found) == limits.GUESSES
    least = np.sort(rows[:, 14])[-limits.GUESSES]
    of_rows = {tuple(row[4:6] + np.float32([2.0, 0.0])) for row in rows[rows[:, 14] >= least]}
    assert {tuple(face.middle.astype(np.float32)) for face in found} == of_rows


def test_yunet_needs_a_model() -> None:
    with pytest.raises(UsageError, match="--detector-model"):
        FaceDetector(DetectionSettings(detector="yunet"))


def test_a_missing_model_and_a_file_that_is_none_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="model not found"):
        FaceDetector(DetectionSettings(detector="yunet", model=str(tmp_path / "none.onnx")))
    wrong = tmp_path / "wrong.onnx"
    wrong.write_bytes(b"no network")
    with pytest.raises(UsageError, match="not a YuNet model"):
        FaceDetector(DetectionSettings(detector="yunet", model=str(wrong)))


class Upright:
    """Finds a drawn face by the dark square above the bright one, where these stand upright."""

    def find(self, image: np.ndarray, scale: float = 1.0) -> tuple[FaceGuess, ...]:
        dark, bright = (np.argwhere(mask).mean(axis=0)[::-1] for mask in (image < 40, image > 215))
        upright = bright[1] - dark[1] > 0.97 * np.linalg.norm(bright - dark)
        return (FaceGuess(dark, scale * 20.0, 0.0, 0.9, (dark[None], dark[None])),) if upright else ()

    def find_turned(self, image: np.ndarray, scale: float = 1.0) -> tuple[FaceGuess, ...]:
        return ()

    find_again = find_turned


@pytest.mark.parametrize("degrees", [-60.0, -35.0, 30.0, 90.0, 179.0])
@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_a_rolled_face_is_found_where_it_is(degrees: float, scale: float) -> None:
    """By one of the rotations, which are 24 degrees apart; a reduced pixel is two recorded ones wide."""
    image, roll = np.full((320, 440), 128, np.uint8), np.radians(degrees)
    dark = np.array([180.0, 140.0])
    bright = dark + 80.0 * np.array([-np.sin(roll), np.cos(roll)])
    for place, value in ((dark, 0), (bright, 255)):
        x, y = np.rint(place).astype(int)
        image[y - 12 : y + 13, x - 12 : x + 13] = value
    searched = SearchedImage.part(image, scale**2 * image.size)
    found = [face for turn in ROTATIONS for face in searched.faces(Upright(), Way(roll=turn))]
    assert found
    for face in found:
        np.testing.assert_allclose(face.middle, dark, atol=1.0 / scale)
        np.testing.assert_allclose(face.eyes[0][0], dark, atol=1.0 / scale)
        assert face.eye_distance == pytest.approx(20.0)
        off = (np.degrees(face.roll) - degrees + 180.0) % 360.0 - 180.0
        assert abs(off) < 14.1 + 1.2  # arccos .97, and a pixel
    assert not list(searched.faces(Upright(), Way(roll=roll + np.pi)))


def test_an_opencv_without_cascades_is_named_with_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenCV 5 has none; packages that bring their own may put it over the one that was installed."""
    monkeypatch.delattr(cv2, "CascadeClassifier")
    monkeypatch.setattr(cv2, "__version__", "5.0.0")
    with pytest.raises(PosetrackError) as raised:
        HaarFaces()
    assert "found OpenCV 5.0.0, expected 4.9 or later, below 5" in str(raised.value)
    assert "'opencv-python-headless<5'" in str(raised.value)
