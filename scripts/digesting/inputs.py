"""Inputs that no command writes: image folders, a video, bags, keypoints, calibration boards, ...

They are derived from synthetic recordings in the same folder, with the helpers of the tests.
"""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.reader import make_reader

DEPTH_TOPIC, INFO_TOPIC = "/camera/depth/image_rect_raw", "/camera/depth/camera_info"
GREY_TOPIC, GREY_INFO_TOPIC = "/camera/left/image_raw", "/camera/left/camera_info"
TENTHS_MISSING = 65535  # missing reading in the folder with tenths of a millimetre
KEYPOINT_SCATTER_PX = 3.0
CLICK_ERROR_PX = 0.5


def helper(name: str) -> Any:
    """Return a module of the tests' helpers."""
    return import_module(f"support.{name}")


def opened(recording: Path, pixels: str) -> Any:
    """Open a recording."""
    from posetrack_cli.recording.opening import open_recording

    return open_recording(recording, pixels)  # type: ignore[arg-type]


def truth_of(recording: Path, topic: str) -> list[tuple[dict[str, Any], Any]]:
    """Return the ground truth of a synthetic recording, with points (N, 3), mm."""
    with recording.open("rb") as stream:
        estimates = [json.loads(m.data) for _, _, m in make_reader(stream).iter_messages([topic])]
    return [
        (one, np.array([[point[axis] for axis in "xyz"] for point in one["points"]])) for one in estimates
    ]


def write_depth_folder(folder: Path) -> None:
    """Write depth in whole millimetres, with a camera file."""
    _write_depth(folder / "depth", folder / "hand-C.mcap", folder / "depth" / "camera.toml", 1.0)


def write_tenths_folder(folder: Path) -> None:
    """Write depth in tenths of a millimetre with a value for missing readings, and a camera file."""
    _write_depth(folder / "tenths", folder / "near.mcap", folder / "tenths.toml", 10.0)


def _write_depth(target: Path, path: Path, camera: Path, per_mm: float) -> None:
    target.mkdir()
    recording = opened(path, "depth")
    for frame in recording.frames():
        codes = np.round(frame.images[0] * per_mm).astype(np.uint16)
        if per_mm != 1.0:
            codes[codes == 0] = TENTHS_MISSING
        cv2.imwrite(str(target / f"{frame.index:06d}.png"), codes)
    lines = (f"{key} = {getattr(recording.cameras[0], key)!r}\n" for key in ("fx", "fy", "cx", "cy"))
    camera.write_text("".join(lines))


def write_pair_folder(folder: Path) -> None:
    """Write depth of a hand and of its mirror image beside it, with a camera file."""
    _write_depth(folder / "pair", folder / "hand-C.mcap", folder / "pair" / "camera.toml", 1.0)
    for path in sorted((folder / "pair").glob("*.png")):
        depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert depth is not None
        both = [np.roll(one, shift, axis=1) for one, shift in ((depth, -90), (depth[:, ::-1], 90))]
        far = np.where(np.array(both) > 0, both, np.iinfo(np.uint16).max).min(axis=0)
        cv2.imwrite(str(path), np.where(far == np.iinfo(np.uint16).max, 0, far).astype(np.uint16))


def write_face_truth(folder: Path) -> None:
    """Write 68 landmarks of a face whose mouth opens."""
    stamps = [one["stamp_ns"] for one, _ in truth_of(folder / "one.mcap", "/truth/head/estimate")]
    names = [f"p{k}_{axis}_mm" for k in range(68) for axis in "xyz"]
    rows = [",".join(["stamp_ns", *names])]
    for k, stamp in enumerate(stamps):
        points = np.zeros((68, 3))
        points[66, 1] = -float(k)
        rows.append(",".join([str(stamp), *map(str, points.ravel())]))
    (folder / "face-truth.csv").write_text("\n".join(rows) + "\n")


def copy_images(folder: Path) -> None:
    """Copy the images of one camera without calibration."""
    (folder / "uncalibrated").mkdir()
    for path in sorted((folder / "faces" / "left").glob("*.png")):
        shutil.copy(path, folder / "uncalibrated" / path.name)


def write_video(folder: Path) -> None:
    """Write a camera's images as H.264 in MP4."""
    import av

    with av.open(str(folder / "face.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"crf": "12"})
        stream.pix_fmt = "yuv420p"
        camera = opened(folder / "one.mcap", "grey").cameras[0]
        stream.width, stream.height = camera.width, camera.height
        for frame in opened(folder / "one.mcap", "grey").frames():
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame.images[0], format="gray")))
        container.mux(stream.encode(None))


def write_bags(folder: Path) -> None:
    """Write depth as one ROS 1 bag and grey images of a camera as another."""
    write_bag = helper("bags").write_bag
    write_bag(folder / "depth.bag", "lz4", lambda messages: _depth_messages(folder, messages))
    grey = (GREY_TOPIC, GREY_INFO_TOPIC, "mono8", np.uint8)
    write_bag(folder / "grey.bag", "none", lambda messages: _messages(folder / "two.mcap", messages, *grey))


def write_ros2_folder(folder: Path) -> None:
    """Write depth as a ROS 2 bag (SQLite)."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores

    messages = helper("bags").Messages(Stores.ROS2_HUMBLE)
    with Writer(folder / "ros2", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        messages.write(_depth_messages(folder, messages), writer, messages.store.serialize_cdr)


def _depth_messages(folder: Path, messages: Any) -> Iterator[tuple[str, int, Any]]:
    return _messages(folder / "hand-C.mcap", messages, DEPTH_TOPIC, INFO_TOPIC, "16UC1", np.uint16)


def _messages(
    path: Path, messages: Any, topic: str, info: str, encoding: str, kind: Any
) -> Iterator[tuple[str, int, Any]]:
    """Yield topic, number and message of the calibration and images of the first camera."""
    recording = opened(path, "depth" if kind is np.uint16 else "grey")
    camera = recording.cameras[0]
    k = np.array([camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1.0])
    described = messages.camera_info("sensor")
    letters = ("K", "P") if hasattr(described, "K") else ("k", "p")
    changes = dict(zip(letters, (k, np.insert(k, (3, 6, 9), 0.0)), strict=True))
    yield info, 0, replace(described, width=camera.width, height=camera.height, **changes)
    for frame in recording.frames():
        image = np.round(frame.images[0]).astype(kind)
        yield topic, frame.index, messages.image(frame.index, "sensor", encoding, image)


def write_kinect_file(folder: Path) -> None:
    """Write a Matroska file like the Azure Kinect recorder."""
    helper("kinect").write_kinect(folder / "kinect.mkv")


def write_keypoints(folder: Path) -> None:
    """Write noisy hand joints in pixels, and ground truth in the format of ``eval`` and ``--keypoints``."""
    from posetrack_cli.hand.model.anatomy import JOINT_NAMES

    recording = folder / "hand-C.mcap"
    camera, rng = opened(recording, "depth").cameras[0], np.random.default_rng(5)
    truth = truth_of(recording, "/truth/hand/estimate")
    frames = []
    for estimate, points in truth:
        places = camera.pixels_from_points(points)[0]
        places = places + rng.normal(0.0, KEYPOINT_SCATTER_PX, places.shape)
        landmarks = places.round(2).tolist()
        frames.append({"frame": estimate["frame_index"], "landmarks": landmarks, "side": "left"})
    (folder / "keypoints.json").write_text(json.dumps(frames))
    with (folder / "joints.csv").open("w", newline="") as stream:
        rows = csv.writer(stream, lineterminator="\n")
        rows.writerow(["stamp_ns", *(f"{joint}_{axis}_mm" for joint in JOINT_NAMES for axis in "xyz")])
        for estimate, points in truth:
            rows.writerow([estimate["stamp_ns"], *points.ravel().round(3).tolist()])


def write_landmarks(folder: Path) -> None:
    """Write noisy face points in pixels, and those of the first frame in the format of ``--init``."""
    from posetrack_cli.head.face.points import POINT_NAMES

    camera, rng = opened(folder / "two.mcap", "grey").cameras[0], np.random.default_rng(6)
    landmarks, clicked = ["frame,point,x,y"], ["camera,point,x,y"]
    for estimate, points in truth_of(folder / "two.mcap", "/truth/head/estimate"):
        places = camera.pixels_from_points(points)[0]
        places = places + rng.normal(0.0, CLICK_ERROR_PX, places.shape)
        named = [f"{name},{x:.2f},{y:.2f}" for name, (x, y) in zip(POINT_NAMES, places, strict=True)]
        landmarks += [f"{estimate['frame_index']},{row}" for row in named]
        clicked += [] if len(clicked) > 1 else [f"{camera.name},{row}" for row in named]
    (folder / "landmarks.csv").write_text("\n".join(landmarks) + "\n")
    (folder / "clicked.csv").write_text("\n".join(clicked) + "\n")


def write_mesh(folder: Path) -> None:
    """Write a hand as glTF with WebXR joint names."""
    from posetrack_cli.hand.model.anatomy import make_anatomy

    helper("glb").write_hand(folder / "hand.glb", make_anatomy("right", 1.02), np.eye(22)[6])


def write_people(folder: Path) -> None:
    """Write results of three people with the motions that ``head build-model`` requires."""
    faces = helper("face_people")
    for number, face in enumerate(faces.people(3)):
        faces.write_stereo_result(folder / f"person-{number}.mcap", faces.performance(face, 120))


def write_boards(folder: Path) -> None:
    """Write images of a chessboard and a ChArUco board from two cameras."""
    boards = helper("boards")
    boards.write_views(folder / "chessboard", boards.CHESSBOARD, boards.cameras(), boards.poses(6))
    boards.write_views(folder / "charuco", boards.CHARUCO, boards.cameras(), boards.poses(6, seed=2))


def write_lists(folder: Path) -> None:
    """Write a manifest of two recordings, a list of one, and a gate file."""
    (folder / "manifest.toml").write_text(
        'gates = ["coverage < 0.5"]\n[options]\nparticles = 64\nend = 6\n'
        '[[recordings]]\npath = "hand-C.mcap"\ntruth = "joints.csv"\n'
        '[[recordings]]\npath = "near.mcap"\nname = "lab/near"\noptions = { hand-side = "left" }\n'
    )
    (folder / "list.txt").write_text("two.mcap\n")
    (folder / "gates.txt").write_text("coverage < 0.5\njoint_error_mm.mean > 20\n")
