"""Files of keypoints: every layout gives the same points back; what cannot be meant is told in a line."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posetrack_cli import limits
from posetrack_cli.errors import UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.keypoints.file import KeypointFile, read_keypoints
from posetrack_cli.hand.keypoints.targets import HAND_POINTS
from posetrack_cli.hand.model.anatomy import JOINT_NAMES
from posetrack_cli.recording.base import StoredFrame
from posetrack_cli.recording.keypoints.formats import parse_keypoints
from posetrack_cli.recording.keypoints.layout import SetCollector, point_column
from posetrack_cli.recording.keypoints.reading import KeypointUse, fitted_to

CAMERA = Camera(512, 424, 365.0, 365.0, 255.5, 211.5)
FRAMES = (0, 1, 4)
RNG = np.random.default_rng(5)
PIXELS = np.round(RNG.uniform([150, 100], [350, 300], (3, 21, 2)), 3)
SPACE = np.round(RNG.uniform([-100, -100, 500], [100, 100, 700], (3, 21, 3)), 3)
SCORES = np.round(RNG.uniform(0.2, 1.0, (3, 21)), 3)
MEDIAPIPE = [
    "WRIST",
    *(f"THUMB_{joint}" for joint in ("CMC", "MCP", "IP", "TIP")),
    *(
        f"{f}_{j}"
        for f in ("INDEX_FINGER", "MIDDLE_FINGER", "RING_FINGER", "PINKY")
        for j in ("MCP", "PIP", "DIP", "TIP")
    ),
]
EXACT = 1e-9


def read(path: Path, **options: Any) -> KeypointFile:
    return read_keypoints(path, CAMERA, **options)


def written(tmp_path: Path, content: Any, name: str = "k.csv") -> Path:
    path = tmp_path / name
    text = content if isinstance(content, str) else json.dumps(content)
    path.write_text(text)
    return path


def csv_of(header: list[str], rows: list[list[Any]]) -> str:
    return "\n".join(",".join(map(str, row)) for row in [header, *rows]) + "\n"


def wide(columns: Callable[[int, str], str], points: np.ndarray, axes: str, key: str = "frame") -> str:
    header = [key, *(columns(k, axis) for k in range(21) for axis in axes)]
    return csv_of(header, [[f, *p.ravel()] for f, p in zip(FRAMES, points, strict=True)])


def long(points: np.ndarray, name: Callable[[int], Any], axes: str = "xy") -> str:
    header = ["frame", "landmark", *axes, "score"]
    rows = [
        [f, name(k), *p[k], SCORES[n, k]]
        for n, (f, p) in enumerate(zip(FRAMES, points, strict=True))
        for k in range(21)
    ]
    return csv_of(header, rows)


def named(points: np.ndarray, n: int) -> list[dict[str, float]]:
    return [
        dict(zip("xyz", point, strict=False)) | {"score": SCORES[n, k]}
        for k, point in enumerate(points.tolist())
    ]


COCO = [
    "wrist",
    *(f"thumb{k}" for k in range(1, 5)),
    *(f"forefinger{k}" for k in range(1, 5)),
    *(f"{f}_finger{k}" for f in ("middle", "ring", "pinky") for k in range(1, 5)),
]
"""Names of COCO's whole body, which MMPose's hands have."""


def deeplabcut(images: bool = False) -> str:
    """A table with the header of DeepLabCut; of labelled images with their folders in three columns."""
    names = [name.lower() for name in MEDIAPIPE]
    blank = ["", ""] if images else []
    coords = ("x", "y") if images else ("x", "y", "likelihood")
    header = [
        ["scorer", *blank, *["net"] * (21 * len(coords))],
        ["bodyparts", *blank, *(name for name in names for _ in coords)],
        ["coords", *blank, *(list(coords) * 21)],
    ]
    rows = []
    for f, p in zip(FRAMES, PIXELS, strict=True):
        key = ["labeled-data", "take2", f"img{f:04d}.png"] if images else [f]
        rows.append([*key, *(v for x, y in p.tolist() for v in (x, y, 0.97)[: len(coords)])])
    return csv_of(header[0], [*header[1:], *rows])


WHOLE_SCORES = [0.0] * 112 + [0.8] * 21


def whole_body(hand: np.ndarray) -> list[list[float]]:
    """133 points of a body of which the right hand is seen."""
    return [[0.0, 0.0]] * 112 + hand.tolist()  # type: ignore[no-any-return]


NORMALISED = (PIXELS + 0.5) / [512, 424]
LAYOUTS: dict[str, tuple[str, Any, np.ndarray]] = {
    "wide, x0 y0": ("k.csv", wide(lambda k, a: f"{a}{k}", PIXELS, "xy"), PIXELS),
    "wide, x_0": ("k.csv", wide(lambda k, a: f"{a}_{k}", PIXELS, "xy"), PIXELS),
    "wide, landmark_0_x": ("k.csv", wide(lambda k, a: f"landmark_{k}_{a}", PIXELS, "xy"), PIXELS),
    "wide, our names in mm": ("k.csv", wide(lambda k, a: f"{JOINT_NAMES[k]}_{a}_mm", SPACE, "xyz"), SPACE),
    "wide, MediaPipe's names": ("k.csv", wide(lambda k, a: f"{MEDIAPIPE[k]}_{a}", PIXELS, "xy"), PIXELS),
    "wide, metres": ("k.csv", wide(lambda k, a: f"{a}{k}", SPACE / 1000.0, "xyz"), SPACE),
    "wide, mm by numbers": ("k.csv", wide(lambda k, a: f"{a}{k}", SPACE, "xyz"), SPACE),
    "wide, normalised": ("k.csv", wide(lambda k, a: f"{a}{k}", NORMALISED, "xy"), PIXELS),
    "long, numbers": ("k.csv", long(PIXELS, lambda k: k), PIXELS),
    "long, our names": ("k.csv", long(PIXELS, lambda k: JOINT_NAMES[k]), PIXELS),
    "long, MediaPipe's names": ("k.csv", long(SPACE, lambda k: MEDIAPIPE[k], "xyz"), SPACE),
    "JSON, lists": (
        "k.json",
        [{"frame": f, "landmarks": p.tolist()} for f, p in zip(FRAMES, PIXELS, strict=True)],
        PIXELS,
    ),
    "JSON, x y z score": (
        "k.json",
        {
            "unit": "mm",
            "frames": [
                {"frame": f, "landmarks": [[*v, 1.0] for v in p.tolist()]}
                for f, p in zip(FRAMES, SPACE, strict=True)
            ],
        },
        SPACE,
    ),
    "JSON, objects": (
        "k.json",
        [{"frame": f, "landmarks": named(p, n)} for n, (f, p) in enumerate(zip(FRAMES, PIXELS, strict=True))],
        PIXELS,
    ),
    "JSON, by name": (
        "k.json",
        [
            {"frame": f, "keypoints": dict(zip(MEDIAPIPE, p.tolist(), strict=True))}
            for f, p in zip(FRAMES, PIXELS, strict=True)
        ],
        PIXELS,
    ),
    "JSON, by place in the list": (
        "k.json",
        [PIXELS[0].tolist(), PIXELS[1].tolist(), None, {}, PIXELS[2].tolist()],
        PIXELS,
    ),
    "JSON, object of frames": (
        "k.json",
        {str(f): p.tolist() for f, p in zip(FRAMES, PIXELS, strict=True)},
        PIXELS,
    ),
    "JSON, MediaPipe's solutions": (
        "k.json",
        [
            {
                "frame": f,
                "multi_hand_landmarks": [{"landmark": named(p, n)}],
                "multi_handedness": [{"classification": [{"index": 0, "score": 0.9, "label": "Left"}]}],
            }
            for n, (f, p) in enumerate(zip(FRAMES, NORMALISED, strict=True))
        ],
        PIXELS,
    ),
    "JSON, MediaPipe's tasks": (
        "k.json",
        [
            {
                "frame": f,
                "handLandmarks": [named(p, n)],
                "handedness": [[{"score": 0.9, "categoryName": "Left"}]],
            }
            for n, (f, p) in enumerate(zip(FRAMES, NORMALISED, strict=True))
        ],
        PIXELS,
    ),
    "JSON lines": (
        "k.jsonl",
        "\n".join(
            json.dumps({"frame": f, "landmarks": p.tolist()}) for f, p in zip(FRAMES, PIXELS, strict=True)
        ),
        PIXELS,
    ),
    "COCO": (
        "k.json",
        {
            "images": [{"id": 7 + f, "file_name": f"rec/{f:06d}.png"} for f in FRAMES],
            "annotations": [
                {"image_id": 7 + f, "keypoints": [v for x, y in p.tolist() for v in (x, y, 2)]}
                for f, p in zip(FRAMES, PIXELS, strict=True)
            ],
            "categories": [{"keypoints": MEDIAPIPE}],
        },
        PIXELS,
    ),
    "DeepLabCut": ("k.csv", deeplabcut(), PIXELS),
    "DeepLabCut, labelled images": ("k.csv", deeplabcut(images=True), PIXELS),
    "SLEAP": (
        "k.csv",
        csv_of(
            [
                "track",
                "frame_idx",
                *(f"{n}.{a}" for n in COCO for a in ("x", "y", "score")),
                "instance.score",
            ],
            [
                ["", f, *(v for x, y in p.tolist() for v in (x, y, 1.08)), 17.3]
                for f, p in zip(FRAMES, PIXELS, strict=True)
            ],
        ),
        PIXELS,
    ),
    "MMPose": (
        "k.json",
        [
            {"frame_id": f, "instances": [{"keypoints": p.tolist(), "keypoint_scores": [0.8] * 21}]}
            for f, p in zip(FRAMES, PIXELS, strict=True)
        ],
        PIXELS,
    ),
    "MMPose, names in another order": (
        "k.json",
        {
            "meta_info": {"keypoint_id2name": {str(k): name for k, name in enumerate(reversed(COCO))}},
            "instance_info": [
                {"frame_id": f, "instances": [{"keypoints": p[::-1].tolist()}]}
                for f, p in zip(FRAMES, PIXELS, strict=True)
            ],
        },
        PIXELS,
    ),
    "MMPose, whole body": (
        "k.json",
        [
            {"frame_id": f, "instances": [{"keypoints": whole_body(p), "keypoint_scores": WHOLE_SCORES}]}
            for f, p in zip(FRAMES, PIXELS, strict=True)
        ],
        PIXELS,
    ),
    "export of ours, JSON": (
        "k.json",
        {
            "header": {},
            "columns": {
                "frame_index": list(FRAMES),
                "status": ["tracking"] * 3,
                "confidence": [0.5, 0.6, 0.7],
            }
            | {
                f"{name}_{a}_mm": SPACE[:, k, i].tolist()
                for k, name in enumerate(JOINT_NAMES)
                for i, a in enumerate("xyz")
            },
        },
        SPACE,
    ),
}


@pytest.mark.parametrize("layout", list(LAYOUTS))
def test_every_layout_gives_the_points_back(tmp_path: Path, layout: str) -> None:
    name, content, points = LAYOUTS[layout]
    found = read(written(tmp_path, content, name))
    assert found.sets.keys.tolist() == list(FRAMES) and not found.sets.by_stamp
    np.testing.assert_allclose(
        found.sets.points[..., : points.shape[2]],
        points,
        atol=EXACT * 1e6 if "norm" in layout or "Media" in layout else EXACT,
    )
    assert found.in_pixels == (points is PIXELS)


def openpose(tmp_path: Path, frames: Sequence[int] = FRAMES) -> Path:
    folder = tmp_path / "openpose"
    folder.mkdir()
    for f, p in zip(frames, PIXELS, strict=True):
        person = {
            "hand_left_keypoints_2d": [0] * 63,
            "hand_right_keypoints_2d": [v for x, y in p.tolist() for v in (x, y, 0.8)],
        }
        path = folder / f"take_{f:012d}_keypoints.json"
        path.write_text(json.dumps({"version": 1.3, "people": [person]}))
    return folder


def test_a_folder_of_openpose_has_a_file_per_frame(tmp_path: Path) -> None:
    """A hand that was not found is all zeros there, and is none."""
    found = read(openpose(tmp_path))
    assert found.sets.keys.tolist() == list(FRAMES)
    np.testing.assert_allclose(found.sets.points[..., :2], PIXELS, atol=EXACT)
    np.testing.assert_allclose(found.sets.right, 1.0)
    assert read(tmp_path / "openpose" / "take_000000000001_keypoints.json").sets.keys.tolist() == [1]
    (tmp_path / "openpose" / "readme.json").write_text("[]")
    with pytest.raises(UsageError, match=r"readme\.json: no frame number in file name"):
        read(tmp_path / "openpose")


class Stamped:
    """A recording of which stamps count."""

    def __init__(self, stamps: Sequence[int]) -> None:
        self.stamps, self.frame_count = stamps, len(stamps)

    def stored_frames(self, losses: Any) -> Iterator[tuple[int, StoredFrame]]:
        return ((k, StoredFrame(stamp, "", ())) for k, stamp in enumerate(self.stamps))


def test_numbers_count_from_one_where_the_last_is_the_number_of_frames(tmp_path: Path) -> None:
    frames = [1, 2, 5]
    sets = read(openpose(tmp_path, frames)).sets
    shifted, words = fitted_to(sets, Stamped(range(5)))  # type: ignore[arg-type]
    assert shifted.keys.tolist() == [0, 1, 4] and words == "frame numbers count from 1: the last is 5 of 5"
    for count in (4, 6):
        assert fitted_to(sets, Stamped(range(count)))[0] is sets  # type: ignore[arg-type]


@pytest.mark.parametrize("is_right", [True, False])
def test_stamps_count_before_numbers_only_if_they_are_the_recording_s(tmp_path: Path, is_right: bool) -> None:
    """Of a video whose rate falls from 30 to 15 Hz a script wrote frame / average rate."""
    truth = [33_000_000 * min(k, 20) + 67_000_000 * max(k - 20, 0) for k in range(60)]
    stated = truth if is_right else [round(k * truth[-1] / 59) for k in range(60)]
    header = ["frame", "timestamp_ms", *(f"{a}{k}" for k in range(21) for a in "xy")]
    rows = [[k, stamp / 1e6, *(PIXELS[0] + k).ravel()] for k, stamp in enumerate(stated)]
    sets, words = fitted_to(read(written(tmp_path, csv_of(header, rows))).sets, Stamped(truth))  # type: ignore[arg-type]
    assert sets.by_stamp == is_right
    for k, stamp in enumerate(truth):
        (own,) = sets.points[sets.of(k, stamp)]
        np.testing.assert_allclose(own[:, :2], PIXELS[0] + k)
    if not is_right:
        assert (
            "stamps differ from the recording's by up to 0.45 s" in words and "using frame numbers" in words
        )


def test_a_neighbour_s_stamp_is_no_match_at_a_high_rate(tmp_path: Path) -> None:
    """At 200 Hz the next frame is 5 ms away, less than the largest difference of stamps."""
    header = ["stamp_ns", *(f"{a}{k}" for k in range(21) for a in "xy")]
    rows = [[5_000_000 * k, *PIXELS[0].ravel()] for k in (0, 2, 3)]
    recording = Stamped([5_000_000 * k for k in range(4)])
    sets, _ = fitted_to(read(written(tmp_path, csv_of(header, rows))).sets, recording)  # type: ignore[arg-type]
    assert [sets.of(k, 5_000_000 * k).start == sets.of(k, 5_000_000 * k).stop for k in range(4)] == [
        False,
        True,
        False,
        False,
    ]


def test_a_header_of_deeplabcut_that_ends_early(tmp_path: Path) -> None:
    text = "\n".join(deeplabcut().splitlines()[:2]) + "\n"
    with pytest.raises(UsageError, match="incomplete DeepLabCut header"):
        read(written(tmp_path, text))


def test_joints_have_the_names_and_order_that_mediapipe_gives_them() -> None:
    assert [HAND_POINTS.number(name) for name in MEDIAPIPE] == list(range(21))
    assert [HAND_POINTS.number(name) for name in JOINT_NAMES] == list(range(21))
    assert HAND_POINTS.number("HandLandmark.PINKY_TIP") == 20 and HAND_POINTS.number("elbow") is None
    assert (
        point_column(HAND_POINTS, "thumb_cmc_flexion_rad") is None
        and point_column(HAND_POINTS, "vx_mm_s") is None
    )
    found = point_column(HAND_POINTS, "thumb_cmc_x_mm")
    assert found is not None and (found.point, found.value, found.unit) == (1, 0, "mm")


def test_a_result_is_exported_as_a_file_of_keypoints(tmp_path: Path) -> None:
    header = [
        "frame_index",
        "stamp_ns",
        "status",
        "confidence",
        "x_mm",
        "y_mm",
        "z_mm",
        "qx",
        "thumb_cmc_flexion_rad",
    ]
    header += [f"{name}_{axis}_mm" for name in JOINT_NAMES for axis in "xyz"]
    rows = [
        [k, 10**9 * k, "lost" if k == 1 else "tracking", 0.5, 1, 2, 3, 0, 0.1, *SPACE[k].ravel()]
        for k in range(3)
    ]
    found = read(written(tmp_path, "# a comment\n" + csv_of(header, rows)))
    assert found.sets.by_stamp and found.sets.keys.tolist() == [0, 2 * 10**9]  # what is lost tells nothing
    np.testing.assert_allclose(found.sets.points, SPACE[[0, 2]])
    assert (found.sets.scores == 0.5).all() and found.unit == "mm"


@pytest.mark.parametrize(
    ("key", "value", "ns"),
    [
        ("stamp_ns", "33333333", 33333333),
        ("timestamp_ms", "33.5", 33_500_000),
        ("time_s", "1700000000.123456789", 1700000000123456789),
        ("t_us", "7", 7000),
    ],
)
def test_stamps_are_exact_in_every_unit(tmp_path: Path, key: str, value: str, ns: int) -> None:
    text = csv_of([key, *(f"{a}{k}" for k in range(21) for a in "xy")], [[value, *PIXELS[0].ravel()]])
    found = read(written(tmp_path, text)).sets
    assert found.by_stamp and found.keys.tolist() == [ns]
    assert found.of(99, ns + 9_999_999) == slice(0, 1) and found.of(99, ns + 10_000_001) == slice(0, 0)


def test_frames_are_matched_by_number_or_by_the_nearest_stamp(tmp_path: Path) -> None:
    numbers = read(written(tmp_path, LAYOUTS["wide, x0 y0"][1])).sets
    assert [numbers.of(index, 0) for index in (0, 1, 2, 4)] == [
        slice(0, 1),
        slice(1, 2),
        slice(2, 2),
        slice(2, 3),
    ]
    text = csv_of(
        ["stamp_ns", *(f"{a}{k}" for k in range(21) for a in "xy")],
        [[s, *p.ravel()] for s, p in zip((1000, 5_000_000, 33_000_000), PIXELS, strict=True)],
    )
    stamps = read(written(tmp_path, text)).sets
    assert stamps.of(0, 4_000_000) == slice(1, 2) and stamps.of(0, 2_000_000) == slice(0, 1)


def test_missing_points_and_scores_of_nothing_are_allowed(tmp_path: Path) -> None:
    text = csv_of(
        ["frame", *(f"{a}{k}" for k in range(21) for a in "xy")],
        [[0, "", "nan", *PIXELS[0].ravel()[2:]], [1, *[""] * 42]],
    )
    found = read(written(tmp_path, text)).sets
    assert (
        len(found) == 1 and np.isnan(found.points[0, 0]).all() and np.isfinite(found.points[0, 1:, 0]).all()
    )
    zeros = [{"landmarks": [{"x": x, "y": y, "visibility": 0.0} for x, y in PIXELS[0].tolist()]}]
    assert (read(written(tmp_path, zeros, "k.json")).sets.scores == 1.0).all()
    scored = read(written(tmp_path, LAYOUTS["long, numbers"][1])).sets
    np.testing.assert_allclose(scored.scores, SCORES)


def test_flags_of_coco_are_scores(tmp_path: Path) -> None:
    content = json.loads(json.dumps(LAYOUTS["COCO"][1]))
    content["annotations"][0]["keypoints"][2], content["annotations"][0]["keypoints"][5] = 0, 1
    found = read(written(tmp_path, content, "k.json")).sets
    assert np.isnan(found.points[0, 0]).all() and found.scores[0, 1] == 0.5 and found.scores[0, 2] == 1.0


@pytest.mark.parametrize(
    ("field", "swap", "right", "sides"),
    [
        ("side", False, 0.9, "as told"),
        ("side", True, 0.1, "exchanged"),
        ("handedness", False, 0.9, "unsure"),
        ("handedness", True, 0.1, "exchanged"),
        ("multi_handedness", False, 0.1, "exchanged"),
        ("multi_handedness", True, 0.9, "as told"),
    ],
)
def test_labels_of_mediapipes_solutions_are_of_a_mirrored_image(
    tmp_path: Path, field: str, swap: bool, right: float, sides: str
) -> None:
    content = [{"landmarks": PIXELS[0].tolist(), field: {"label": "Right", "score": 0.9}}]
    found = read(written(tmp_path, content, "k.json"), swap_sides=swap)
    assert found.sets.right.tolist() == [pytest.approx(right)] and found.sides == sides
    text = csv_of(
        ["frame", field, f"{field}_score", *(f"{a}{k}" for k in range(21) for a in "xy")],
        [[0, "Right", 0.9, *PIXELS[0].ravel()]],
    )
    assert read(written(tmp_path, text), swap_sides=swap).sets.right.tolist() == [pytest.approx(right)]


def test_a_frame_may_have_several_hands(tmp_path: Path) -> None:
    hands = [
        {"landmarks": PIXELS[0].tolist(), "side": "right"},
        {"landmarks": PIXELS[1].tolist(), "side": "left"},
    ]
    for content in (
        [{"frame": 3, "hands": hands}],
        [{"frame": 3, **hand} for hand in hands],
        [{"frame": 3, "landmarks": PIXELS[:2].tolist(), "side": ["right", "left"]}],
    ):
        found = read(written(tmp_path, content, "k.json")).sets
        assert found.keys.tolist() == [3, 3] and found.right.tolist() == [1.0, 0.0]
        np.testing.assert_allclose(found.points[..., :2], PIXELS[:2])
        assert found.of(3, 0) == slice(0, 2)
    rows = [[3, hand, k, *PIXELS[n, k]] for n, hand in enumerate(("left", "right")) for k in range(21)]
    found = read(written(tmp_path, csv_of(["frame", "hand", "landmark", "x", "y"], rows))).sets
    assert found.right.tolist() == [1.0, 0.0] and found.points[0, 5, 0] == PIXELS[1, 5, 0]


GOOD = LAYOUTS["wide, x0 y0"][1]
HEADER, ROW = GOOD.splitlines()[:2]
FAULTS: dict[str, tuple[str, Any, str]] = {
    "empty": ("k.csv", "", r"k\.csv: is empty.*expected point columns"),
    "no rows": ("k.csv", HEADER, "no keypoints"),
    "no frame": (
        "k.csv",
        GOOD.replace("frame", "foo", 1),
        "line 1: no frame or stamp column, found foo.*stamp_ns",
    ),
    "no points": ("k.csv", "frame,a,b\n1,2,3\n", "line 1: no keypoint columns"),
    "20 points": (
        "k.csv",
        GOOD.replace("x20", "u").replace("y20", "v"),
        "missing point columns, found 20 points, no x of point 20",
    ),
    "22 points": (
        "k.csv",
        GOOD.replace("x20", "x21").replace("y20", "y21"),
        "unknown set of points, found point 21, expected 21 points",
    ),
    "short row": (
        "k.csv",
        f"{HEADER}\n0,1,2\n",
        r"k\.csv line 2: row does not fit the header, found 3 cells, expected 43",
    ),
    "text": (
        "k.csv",
        GOOD.replace(f"{PIXELS[0, 0, 0]}", "abc", 1),
        "line 2, column 2: is not a number, found 'abc'",
    ),
    "infinite": ("k.csv", GOOD.replace(f"{PIXELS[0, 0, 0]}", "inf", 1), "line 2, column 2: is not finite"),
    "large": ("k.csv", GOOD.replace(f"{PIXELS[0, 0, 0]}", "1e300", 1), "line 2, column 2: is too large"),
    "frame number": (
        "k.csv",
        f"{HEADER}\n1.5{ROW[1:]}\n",
        "line 2: frame number is not a whole number, found '1.5'",
    ),
    "stamp": (
        "k.csv",
        f"{HEADER.replace('frame', 'stamp_ns')}\n1e99999{ROW[1:]}\n",
        "line 2: stamp is out of range, found '1e99999'",
    ),
    "semicolons": ("k.csv", GOOD.replace(",", ";"), "not separated by commas, found semicolons"),
    "column twice": ("k.csv", GOOD.replace("x1,", "x0,", 1), "column occurs twice, found x0"),
    "two units": (
        "k.csv",
        GOOD.replace("x0", "x0_mm").replace("y0", "y0_px", 1),
        "columns differ in unit",
    ),
    "point twice": (
        "k.csv",
        "frame,landmark,x,y\n0,wrist,1,2\n0,0,1,2\n",
        "line 3: point occurs twice in a frame, found point 0",
    ),
    "unknown joint": (
        "k.csv",
        "frame,landmark,x,y\n0,thumb_tap,1,2\n",
        "unknown point, found 'thumb_tap'; did you mean 'thumb_tip'",
    ),
    "counted from 1": ("k.csv", "frame,landmark,x,y\n0,21,1,2\n", "no such point, found 21, expected 0"),
    "score": (
        "k.csv",
        "frame,landmark,x,y,score\n0,1,1,2,1.5\n",
        "line 2, score: score out of range, found '1.5', expected 0 to 1",
    ),
    "side": (
        "k.csv",
        "frame,landmark,x,y,side\n0,1,1,2,both\n",
        "line 2: unknown side, found 'both', expected right or left",
    ),
    "latin": ("k.csv", HEADER.encode() + b"\n0,\xe4\n", "line 2: is not UTF-8 text"),
    "no JSON": ("k.json", "{", r"k\.json: is not valid JSON"),
    "JSON NaN": ("k.json", "[[[NaN, 1]]]", "NaN is not valid JSON"),
    "deep JSON": ("k.json", "[" * 100_000, "nested too deeply"),
    "JSON number": ("k.json", "3", "no frames, found int"),
    "JSON object": ("k.json", {"a": 1}, "no frames, found a"),
    "JSON count": (
        "k.json",
        [{"landmarks": PIXELS[0, :5].tolist()}],
        "frame entry 0: unexpected number of points, found 5",
    ),
    "JSON text": ("k.json", [{"landmarks": [["a", 1]] * 21}], "point 0: is not a number, found 'a'"),
    "JSON pair": ("k.json", [{"landmarks": [[1]] * 21}], r"not a point, found 1 numbers, expected \[x, y\]"),
    "JSON unit": ("k.json", {"unit": "inch", "frames": []}, "unknown unit, found 'inch'"),
    "JSON stamps": (
        "k.json",
        [{"stamp_ns": 0, "landmarks": PIXELS[0].tolist()}, {"landmarks": PIXELS[0].tolist()}],
        "frame entry 1: no stamp",
    ),
    "JSON line": ("k.jsonl", "[]\n{\n", r"k\.jsonl line 2: is not valid JSON"),
    "two kinds of sides": (
        "k.json",
        [
            {"landmarks": PIXELS[0].tolist(), "side": "left"},
            {"landmarks": PIXELS[0].tolist(), "handedness": "Left"},
        ],
        "sides given in two fields",
    ),
    "COCO image": (
        "k.json",
        {"images": [], "annotations": [{"image_id": 3, "keypoints": [1] * 63}]},
        "unknown image_id, found 3",
    ),
    "COCO image that is a list": (
        "k.json",
        {"images": [], "annotations": [{"image_id": [3], "keypoints": [1] * 63}]},
        r"unknown image_id, found \[3\]",
    ),
    "COCO points": (
        "k.json",
        {
            "images": [{"id": 3, "file_name": "1.png"}],
            "annotations": [{"image_id": 3, "keypoints": [1] * 51}],
        },
        "found 51 numbers",
    ),
    "export": ("k.json", {"columns": {"frame": [1], "x0": []}}, "columns differ in length"),
    "world landmarks": (
        "k.json",
        [((SPACE[0] - SPACE[0].mean(axis=0)) / 1000).tolist()],
        "points have no position in the image, .*image landmarks",
    ),
    "another image": (
        "k.csv",
        wide(lambda k, a: f"{a}{k}", 9.0 * PIXELS, "xy"),
        "unknown unit.*512x424.*--keypoints-unit",
    ),
}


@pytest.mark.parametrize("fault", list(FAULTS))
def test_what_cannot_be_meant_is_one_line(tmp_path: Path, fault: str) -> None:
    name, content, line = FAULTS[fault]
    path = tmp_path / name
    path.write_bytes(
        content
        if isinstance(content, bytes)
        else (content if isinstance(content, str) else json.dumps(content)).encode()
    )
    with pytest.raises(UsageError, match=line) as error:
        read(path)
    assert "\n" not in str(error.value) and name in str(error.value)


def test_a_frame_of_very_many_hands_is_numbered_without_looking_at_all_of_them_each_time() -> None:
    """A file of one frame alone would else take hours, wherever its hands begin to be counted."""

    class Counted(dict[Any, Any]):
        looked = 0

        def __contains__(self, key: object) -> bool:
            self.looked += 1
            return super().__contains__(key)

    values, count = Counted(), 2000
    collector = SetCollector(Path("k.csv"), HAND_POINTS, False, values)
    for expected in range(count):
        hand = collector.new_hand(7)
        assert hand == expected
        collector.set_of(7, hand, "")
    for start in range(count):
        hand = collector.new_hand(7, start)
        assert hand == count + start
        collector.set_of(7, hand, "")
    assert collector.new_hand(8) == 0 and collector.new_hand(8, 5) == 5
    assert values.looked < 20 * count


def test_a_unit_that_is_told_is_believed(tmp_path: Path) -> None:
    far = written(tmp_path, wide(lambda k, a: f"{a}{k}", 9.0 * PIXELS, "xy"))
    assert read(far, unit="px").sets.points[0, 0, 0] == 9.0 * PIXELS[0, 0, 0]
    with pytest.raises(UsageError, match="points have no z"):
        read(far, unit="mm")


def test_missing_files_and_large_ones_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UsageError, match=r"none\.csv: cannot be read, found No such file"):
        read(tmp_path / "none.csv")
    with pytest.raises(UsageError, match="no keypoint files in folder"):
        read(tmp_path)
    path = written(tmp_path, GOOD)
    monkeypatch.setattr(limits, "KEYPOINT_SETS", 2)
    with pytest.raises(UsageError, match="line 4: too many keypoint sets, found more, expected at most 2"):
        read(path)
    for content in (
        [None] * 3,
        {"images": [], "annotations": [{}] * 3},
        {"images": [{"id": k, "frame": k} for k in range(3)], "annotations": []},
    ):
        with pytest.raises(UsageError, match=r"k\.json: too many frames, found more, expected at most 2"):
            read(written(tmp_path, content, "k.json"))
    monkeypatch.setattr(limits, "KEYPOINT_JSON_BYTES", 20)
    with pytest.raises(UsageError, match=r"more than the limit of 20; use JSON lines"):
        read(written(tmp_path, LAYOUTS["JSON, lists"][1], "k.json"))
    monkeypatch.setattr(limits, "KEYPOINT_BYTES", 20)
    with pytest.raises(UsageError, match=r"is too large, found .* bytes, expected 20 at most"):
        read(path)


def test_the_record_states_digest_unit_and_sides(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD)
    record = read(path).record()
    assert set(record) == {"keypoints", "keypoints.sha256", "keypoints.unit", "keypoints.sides"}
    assert (record["keypoints"], record["keypoints.unit"], record["keypoints.sides"]) == (
        "k.csv",
        "px",
        "none",
    )
    path.write_text(GOOD + "\n")
    assert read(path).record()["keypoints.sha256"] != record["keypoints.sha256"]


def test_a_run_whose_frames_have_hardly_any_keypoints_is_remarked_on(tmp_path: Path) -> None:
    known = read(written(tmp_path, GOOD))
    use = KeypointUse(known.name, known.sets)
    for index in range(4):
        use.see(index, 0)
    assert use.remarks == ()  # two of four
    use.see(5, 0)
    assert use.remarks == ("k.csv has keypoints for 2 of 5 frames, matched by frame number from 0",)


_VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-5, 500)
    | st.floats(allow_nan=False)
    | st.sampled_from(["x", "right", "1", "\x1b[2J"]),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(
                [
                    "frame",
                    "frames",
                    "landmarks",
                    "hands",
                    "handedness",
                    "side",
                    "keypoints",
                    "images",
                    "annotations",
                    "columns",
                    "unit",
                    "label",
                    "x",
                    "y",
                    "0",
                    "x0",
                ]
            ),
            inner,
            max_size=4,
        )
    ),
    max_leaves=12,
)


@given(_VALUES)
@settings(max_examples=200, deadline=None)
def test_no_json_ends_in_anything_but_a_line(tmp_path_factory: pytest.TempPathFactory, value: Any) -> None:
    path = written(tmp_path_factory.getbasetemp(), value, "any.json")
    try:
        parse_keypoints(path, HAND_POINTS)
    except UsageError as error:
        assert str(error).isprintable()
