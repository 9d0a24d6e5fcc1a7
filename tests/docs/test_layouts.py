"""The layouts for Foxglove name topics and fields of every kind of file that they are for."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from posetrack_cli.cli.main import run
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.recording.base import TruthMessage
from posetrack_cli.recording.opening import open_any
from posetrack_cli.results import ResultWriter
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA, ESTIMATE_SCHEMA_NAME, estimate_to_json
from support import images
from support.markdown import ROOT
from support.results import RUN, SUBJECT, make_estimate

FRAMES = 4
LAYOUTS = {"hand": "hand", "head-mono": "head", "head-stereo": "head-stereo"}
"""Name of the layout of each kind of recording."""
IMAGES = {
    "hand": {"/camera/depth/image"},
    "head-mono": {"/camera/image"},
    "head-stereo": {"/camera/left/image", "/camera/right/image"},
}
HEAD = replace(SUBJECT, name="head", lines=((0, 1),), triangles=None)
CAMERA = "fx = 40.0\nfy = 41.0\ncx = 15.0\ncy = 12.0\n"


def write_recording(path: Path, kind: str) -> Path:
    """A folder of images at the stamps of the estimates."""
    stamps = [make_estimate(k).stamp_ns for k in range(FRAMES)]
    pictures = images.grey_images(FRAMES)
    if kind == "head-stereo":
        images.write_rig(path, {"left": pictures, "right": pictures})
    else:
        images.write_images(path, [p.astype("u2") * 4 for p in pictures] if kind == "hand" else pictures)
        (path / "camera.toml").write_text(CAMERA)
    images.write_stamps(path, stamps)
    return path


def write_result(path: Path, recording: Path, kind: str) -> Path:
    """Estimates that are their own truth, and a smoothed track."""
    opened = open_any(recording)
    camera, *others = opened.cameras
    identity = {f"input.{name}": value for name, value in opened.identity().items()}
    subject = replace(SUBJECT if kind == "hand" else HEAD, camera_frame=camera.name)
    topic, schema = f"/truth/{subject.name}/estimate", json.dumps(ESTIMATE_SCHEMA).encode()
    with ResultWriter(path, subject, camera, RUN | identity, others=others) as writer:
        for k in range(FRAMES):
            one = make_estimate(k)
            told = ESTIMATE_SCHEMA_NAME, "jsonschema", schema, "json", one.stamp_ns, estimate_to_json(one)
            writer.add_truth(TruthMessage(topic, *told))
            writer.write(one)
        for k in reversed(range(FRAMES)):
            writer.write_smoothed(make_estimate(k))
        writer.finish({})
    return path


@pytest.fixture(scope="module", params=LAYOUTS)
def kind(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def files(kind: str, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The converted recording, the result, the result with metrics, and all of it in one file."""
    folder = tmp_path_factory.mktemp(kind)
    recording = write_recording(folder / "recording", kind)
    found = {
        name: folder / f"{name}.mcap" for name in ("converted", "result", "evaluated", "joined", "protobuf")
    }
    write_result(found["result"], recording, kind)
    assert run(["convert", str(recording), "--raw", "-o", str(found["converted"])]) == 0
    assert run(["eval", str(found["result"]), "--track", "both", "--mcap", str(found["evaluated"])]) == 0
    view = ["view", str(found["evaluated"]), "--recording", str(recording)]
    assert run([*view, "-o", str(found["joined"])]) == 0
    copy = ["export", str(found["evaluated"]), "--schemas", "protobuf"]
    assert run([*copy, "-o", str(found["protobuf"])]) == 0
    return found


@pytest.fixture(scope="module")
def layout(kind: str) -> Any:
    return json.loads((ROOT / "docs" / f"foxglove-{LAYOUTS[kind]}.json").read_text(encoding="utf-8"))


def described(path: Path) -> dict[str, set[str]]:
    """Of each topic the paths of its fields, such as ``pose.position.x``."""
    found = {}
    for schema, channel in McapFile(path).channels():
        assert schema is not None
        if schema.encoding == "jsonschema":
            found[channel.topic] = set(json.loads(schema.data)["properties"])
        else:
            found[channel.topic] = set(fields(descriptor(schema.data, schema.name)))
    return found


def descriptor(data: bytes, name: str) -> Any:
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(data).file:
        pool.Add(file)
    return pool.FindMessageTypeByName(name)


def fields(message: Any, prefix: str = "", depth: int = 3) -> Iterator[str]:
    for field in message.fields:
        yield f"{prefix}{field.name}"
        if field.message_type is not None and depth:
            yield from fields(field.message_type, f"{prefix}{field.name}.", depth - 1)


def named(layout: Any) -> set[str]:
    """The topics, or topics and fields, that a layout names."""
    paths = set(re.findall(r'"(/[\w/]+(?:\.[\w.]+)?)"', json.dumps(layout)))
    assert len(paths) > 6
    return paths


def lacking(paths: set[str], topics: dict[str, set[str]]) -> set[str]:
    split = {path: path.partition(".") for path in paths}
    return {
        path for path, (topic, _, field) in split.items() if field not in {"", *topics.get(topic, ())}
    } | {path for path, (topic, _, _) in split.items() if topic not in topics}


def panels(node: Any) -> list[str]:
    """The panels of a mosaic, from first to second."""
    if isinstance(node, str):
        return [node]
    assert set(node) == {"direction", "first", "second", "splitPercentage"}
    assert node["direction"] in ("row", "column") and 0 < node["splitPercentage"] < 100
    return [*panels(node["first"]), *panels(node["second"])]


def test_every_panel_is_placed_once(layout: Any) -> None:
    assert set(layout) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
    kinds = {name.split("!")[0] for name in layout["configById"]}
    assert kinds == {"3D", "Image", "StateTransitions", "Plot", "RawMessages"}


def test_a_result_with_images_and_metrics_has_everything(layout: Any, files: dict[str, Path]) -> None:
    assert lacking(named(layout), described(files["joined"])) == set()


@pytest.mark.parametrize("name", ["evaluated", "protobuf"])
def test_a_result_with_metrics_lacks_only_images(
    layout: Any, files: dict[str, Path], name: str, kind: str
) -> None:
    assert lacking(named(layout), described(files[name])) == IMAGES[kind]


def test_a_result_lacks_images_and_metrics(layout: Any, files: dict[str, Path], kind: str) -> None:
    missing = lacking(named(layout), described(files["result"]))
    assert {path for path in missing if not path.startswith("/eval/")} == IMAGES[kind]


def test_a_converted_recording_has_the_images(files: dict[str, Path], kind: str) -> None:
    assert described(files["converted"]).keys() >= IMAGES[kind]


@pytest.mark.parametrize("name", ["joined", "converted"])
def test_images_have_the_frame_of_their_calibration(
    layout: Any, files: dict[str, Path], name: str, kind: str
) -> None:
    """Viewers place images by it."""
    frames = {}
    with files[name].open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            if "/camera/" in channel.topic and hasattr(message, "frame_id"):
                frames.setdefault(channel.topic, set()).add(message.frame_id)
    modes = [panel["imageMode"] for key, panel in layout["configById"].items() if key.startswith("Image!")]
    assert {mode["imageTopic"] for mode in modes} == IMAGES[kind]
    for mode in modes:
        calibration = mode["calibrationTopic"]
        own = "/camera/depth/calibration" if (kind, name) == ("hand", "converted") else calibration
        assert len(frames[mode["imageTopic"]]) == 1
        assert frames[mode["imageTopic"]] == frames[own]


def test_every_message_of_a_joined_file_is_protobuf(files: dict[str, Path]) -> None:
    assert {channel.message_encoding for _, channel in McapFile(files["joined"]).channels()} == {"protobuf"}
