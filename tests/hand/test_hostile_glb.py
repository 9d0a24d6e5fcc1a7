"""GLB files of strangers: what no hand's file says is one line, and costs neither memory nor time."""

from __future__ import annotations

import json
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posetrack_cli import limits
from posetrack_cli.errors import UsageError
from posetrack_cli.hand.model.anatomy import make_anatomy
from posetrack_cli.hand.model.webxr import load_hand
from posetrack_cli.rendering.gltf import read_glb, read_skin
from support.glb import GlbWriter, hand_glb
from support.hand import posed_from

POSE = posed_from(np.zeros(3), np.array([0.4, 0.1, -0.2]), np.tile([0.3, 0.05, 0.4], 5))
Change = Callable[[dict[str, Any]], Any]
MIB = 1 << 20


def written(path: Path, change: Change) -> Path:
    """A hand's file after a change of its JSON."""
    writer = hand_glb(make_anatomy(), POSE)
    change(writer.content)
    path.write_bytes(writer.bytes())
    return path


def refused(path: Path, match: str = "damaged") -> None:
    """Loading fails with one line, and takes little more memory than the file itself; warnings are errors."""
    tracemalloc.start()
    try:
        with pytest.raises(UsageError, match=match) as error:
            load_hand(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert str(error.value).startswith(str(path)) and "\n" not in str(error.value)
    assert peak < 100 * MIB


def accessor(**values: Any) -> Change:
    """The points' accessor changed, or with view the bytes that it lies in."""
    view = values.pop("view", {})

    def change(content: dict[str, Any]) -> None:
        content["accessors"][0].update(values)
        content["bufferViews"][0].update(view)

    return change


@pytest.mark.parametrize(
    "change",
    [
        accessor(count=100_000_000, view={"byteStride": 0}),
        accessor(view={"byteStride": 0}),
        accessor(view={"byteStride": 11}),
        accessor(view={"byteStride": -20}),
        accessor(view={"byteStride": 1 << 62}),
        accessor(count=100_000_000),
        accessor(count=-1),
        accessor(count=1.5),
        accessor(count=True),
        accessor(count=10**400),
        accessor(byteOffset=-4),
        accessor(byteOffset=1 << 40),
        accessor(view={"byteOffset": -4}),
        accessor(view={"byteOffset": 1 << 40}),
        accessor(view={"byteLength": 1 << 40}),
        accessor(view={"byteLength": 12}),
        accessor(bufferView=-1),
        accessor(bufferView="0"),
        accessor(type=["VEC3"]),
    ],
    ids=range(19),
)
def test_elements_lie_one_behind_the_other_in_their_view(tmp_path: Path, change: Change) -> None:
    refused(written(tmp_path / "hand.glb", change))


@pytest.mark.parametrize(
    "change",
    [
        lambda content: content["nodes"][0].update(mesh=-1),
        lambda content: content["nodes"][0].update(mesh=0.0),
        lambda content: content["nodes"][0].update(skin=-1),
        lambda content: content["nodes"][2].update(children=[-1]),
        lambda content: content["nodes"][2].update(children=[10**6]),
        lambda content: content["nodes"][2].update(children=[3.0]),
        lambda content: content["nodes"][2].update(children="text"),
        lambda content: content["skins"][0].update(joints=[-1, *range(1, 25)]),
        lambda content: content["skins"][0].update(joints=[1, *range(1, 25)]),
        lambda content: content["skins"][0].update(inverseBindMatrices=-1),
        lambda content: content["meshes"][0]["primitives"][0].update(indices=-1),
        lambda content: content.update(nodes={"0": {}}),
        lambda content: content.update(meshes="text"),
    ],
    ids=range(13),
)
def test_indices_are_whole_numbers_of_what_is_there(tmp_path: Path, change: Change) -> None:
    refused(written(tmp_path / "hand.glb", change))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("scale", [1e300, 1e300, 1e300]),
        ("scale", [float("nan")] * 3),
        ("scale", [float("inf")] * 3),
        ("scale", [1.0]),
        ("scale", [[1.0, 1.0, 1.0]]),
        ("scale", 10**400),
        ("translation", [1e300, 0.0, 0.0]),
        ("translation", ["a", "b", "c"]),
        ("rotation", [0.0, 0.0, 0.0, 0.0]),
        ("rotation", [1e-300, 0.0, 0.0, 0.0]),
        ("rotation", [1e300, 0.0, 0.0, 1e300]),
        ("matrix", [1e300] * 16),
        ("matrix", [1.0] * 15),
        ("matrix", None),
    ],
)
def test_a_node_s_place_is_made_of_numbers(tmp_path: Path, name: str, value: object) -> None:
    refused(written(tmp_path / "hand.glb", lambda content: content["nodes"][1].update({name: value})))


def test_scales_whose_product_is_no_number(tmp_path: Path) -> None:
    """Each is small enough; all of a chain together are not."""

    def chain(content: dict[str, Any]) -> None:
        first = len(content["nodes"])
        content["nodes"] += [{"scale": [1e6] * 3, "children": [first + k + 1]} for k in range(60)]
        content["nodes"] += [{"children": [1]}]

    refused(written(tmp_path / "hand.glb", chain))


def test_a_node_with_two_parents(tmp_path: Path) -> None:
    refused(written(tmp_path / "hand.glb", lambda content: content["nodes"][0].update(children=[4])))


def chained(count: int) -> Change:
    """So many nodes above the wrist, one above the other."""

    def change(content: dict[str, Any]) -> None:
        first = len(content["nodes"])
        content["nodes"] += [{"children": [first + k + 1]} for k in range(count - 1)]
        content["nodes"] += [{"children": [1]}]

    return change


def test_a_chain_of_nodes_costs_one_step_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All 25 joints hang on its end; each node's own transform is made once."""
    from posetrack_cli.rendering import gltf

    made, local = [0], gltf._local_transform

    def counted(node: dict[str, Any]) -> np.ndarray:
        made[0] += 1
        return local(node)

    count = 5000
    monkeypatch.setattr(gltf, "_local_transform", counted)
    long = read_skin(read_glb(written(tmp_path / "long.glb", chained(count))))
    assert made[0] == count + 25
    short = read_skin(read_glb(written(tmp_path / "short.glb", lambda content: None)))
    np.testing.assert_array_equal(long.vertices, short.vertices)
    assert long.joint_parents == short.joint_parents


def test_more_nodes_than_any_scene_has(tmp_path: Path) -> None:
    refused(written(tmp_path / "hand.glb", chained(20_000)), "too many nodes, found 20026, expected at most")


def test_more_joints_than_any_skin_has(tmp_path: Path) -> None:
    def many(content: dict[str, Any]) -> None:
        content["nodes"] += [{} for _ in range(limits.MESH_JOINTS)]
        content["skins"][0]["joints"] += range(26, 26 + limits.MESH_JOINTS)

    refused(written(tmp_path / "hand.glb", many), "too many joints")


@pytest.mark.parametrize(("copies", "joints", "what"), [(10_000, 0, "points"), (90, 400, "weights")])
def test_parts_that_are_read_again_and_again(tmp_path: Path, copies: int, joints: int, what: str) -> None:
    """A small file may list one array of points in ten thousand parts."""

    def repeat(content: dict[str, Any]) -> None:
        content["meshes"][0]["primitives"] *= copies
        content["nodes"] += [{} for _ in range(joints)]
        content["skins"][0]["joints"] += range(26, 26 + joints)

    refused(written(tmp_path / "hand.glb", repeat), f"too many {what}, found ")


@pytest.mark.parametrize("name", ["POSITION", "JOINTS_0", "WEIGHTS_1", "indices"])
@pytest.mark.parametrize("kind", ["SCALAR", "VEC2", "MAT4"])
def test_elements_of_another_width(tmp_path: Path, name: str, kind: str) -> None:
    """Joints as single numbers would be paired with all points."""

    def widen(content: dict[str, Any]) -> None:
        primitive = content["meshes"][0]["primitives"][0]
        index = (primitive["attributes"] | {"indices": primitive["indices"]})[name]
        count = content["accessors"][index]["count"]
        content["accessors"][index].update(type=kind, count=count // 8 if kind == "MAT4" else count)
        content["bufferViews"][index].pop("byteStride", None)

    if not (name == "indices" and kind == "SCALAR"):
        refused(written(tmp_path / "hand.glb", widen))


def test_numbers_that_are_none(tmp_path: Path) -> None:
    """Points and weights that are not finite, or of another scale than any hand's."""
    for accessor_index, value in ((0, np.inf), (0, np.nan), (0, 3e38), (2, np.inf), (2, np.nan), (2, -3e38)):
        writer = hand_glb(make_anatomy(), POSE)
        start = writer.content["bufferViews"][accessor_index]["byteOffset"]
        number = struct.pack("<f", value)
        writer.binary = writer.binary[:start] + number + writer.binary[start + 4 :]
        path = tmp_path / "hand.glb"
        path.write_bytes(writer.bytes())
        refused(path, "damaged|invalid or too large coordinates")


def glb_of(text: bytes) -> bytes:
    chunk = struct.pack("<I4s", len(text), b"JSON") + text
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunk)) + chunk


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (b'{"nodes": ' + b"[" * 200_000, "has no valid JSON"),
        (b'{"nodes": ' + b'{"a": ' * 100_000, "has no valid JSON"),
        (b'{"nodes": ' + b"9" * 100_000 + b"}", "has no valid JSON"),
        (b'{"nodes": ' + b"9" * 4000 + b"}", "damaged"),
        (b'{"nodes": [' + b"0," * 9000 + b"0]}", "damaged"),
        (b'{"extensionsRequired": [[]]}', "damaged"),
        (b'{"buffers": [3]}', "damaged"),
    ],
    ids=range(7),
)
def test_json_of_another_kind(tmp_path: Path, text: bytes, match: str) -> None:
    path = tmp_path / "hand.glb"
    path.write_bytes(glb_of(text))
    refused(path, match)


def test_joints_that_come_twice(tmp_path: Path) -> None:
    def rename(content: dict[str, Any]) -> None:
        content["nodes"].append({"name": content["nodes"][3]["name"].upper()})
        content["skins"][0]["joints"].append(len(content["nodes"]) - 1)
        content["skins"][0].pop("inverseBindMatrices")

    refused(written(tmp_path / "hand.glb", rename), "has the joint 'thumb-phalanx-proximal' twice")


def test_a_palm_on_one_line(tmp_path: Path) -> None:
    def align(content: dict[str, Any]) -> None:
        by_name = {node["name"]: node for node in content["nodes"]}
        for place, name in enumerate(("index", "middle", "ring", "pinky")):
            far = by_name[f"{name}-finger-metacarpal"]
            far["translation"] = [0.0, 0.0, 0.01 * place]
            far.pop("rotation")
            knuckle = by_name[f"{name}-finger-phalanx-proximal"]
            knuckle["translation"] = [0.0, 0.0, 0.08]
        by_name["wrist"]["translation"] = [0.0, 0.0, 0.0]

    refused(written(tmp_path / "hand.glb", align), "collinear|implausible hand size")


def test_fingers_without_skin(tmp_path: Path) -> None:
    """All of the skin is bound to the wrist."""
    writer = hand_glb(make_anatomy(), POSE)
    for index in (1, 3):  # the joints' accessors
        view = writer.content["bufferViews"][index]
        start, end = view["byteOffset"], view["byteOffset"] + view["byteLength"]
        writer.binary = writer.binary[:start] + bytes(end - start) + writer.binary[end:]
    path = tmp_path / "hand.glb"
    path.write_bytes(writer.bytes())
    refused(path, "thumb has no skin")


def test_a_fan_of_very_many_triangles(tmp_path: Path) -> None:
    """What simplifies a mesh takes the square of the triangles at a point."""
    writer = hand_glb(make_anatomy(), POSE)
    points = writer.content["accessors"][0]["count"]
    fan = 2 * limits.MESH_VALENCE
    corners = 1 + np.arange(fan) % (points - 2)
    triangles = np.stack([np.zeros(fan, dtype=int), corners, corners + 1], axis=1)
    index = writer.accessor(triangles.astype("<u2").ravel(), 5123, "SCALAR")
    writer.content["meshes"][0]["primitives"][0]["indices"] = index
    path = tmp_path / "hand.glb"
    path.write_bytes(writer.bytes())
    refused(path, "skin is not a surface|has no skin")


def test_triangles_that_hang_together_nowhere(tmp_path: Path) -> None:
    writer = hand_glb(make_anatomy(), POSE)
    rng, points = np.random.default_rng(0), writer.content["accessors"][0]["count"]
    index = writer.accessor(rng.integers(0, points, 6000, dtype="<u2"), 5123, "SCALAR")
    writer.content["meshes"][0]["primitives"][0]["indices"] = index
    path = tmp_path / "hand.glb"
    path.write_bytes(writer.bytes())
    refused(path, "skin is not a surface, found .* edges with only one triangle")


def test_an_empty_mesh(tmp_path: Path) -> None:
    def empty(content: dict[str, Any]) -> None:
        primitive = content["meshes"][0]["primitives"][0]
        for index in (*primitive["attributes"].values(), primitive["indices"]):
            content["accessors"][index]["count"] = 0

    refused(written(tmp_path / "hand.glb", empty), "has no skin|damaged")


def test_json_that_python_alone_reads_is_damage(tmp_path: Path) -> None:
    """NaN and Infinity are no JSON, but Python's reader takes them."""
    text = json.dumps({"nodes": [{"mesh": 0, "skin": float("nan")}], "skins": [{}], "meshes": [{}]}).encode()
    path = tmp_path / "hand.glb"
    path.write_bytes(glb_of(text))
    refused(path)


def test_an_accessor_of_all_bytes_is_read(tmp_path: Path) -> None:
    """Views may be padded and accessors begin within them: no valid file is refused."""
    writer = GlbWriter()
    padded = writer.accessor(np.arange(12, dtype="<f4").reshape(4, 3), 5126, "VEC3", padding=4)
    writer.content["accessors"][padded].update(byteOffset=16, count=3)
    writer.content["bufferViews"][padded]["byteLength"] -= 4  # nothing has to follow the last element
    path = tmp_path / "numbers.glb"
    path.write_bytes(writer.bytes())
    np.testing.assert_array_equal(read_glb(path).numbers(padded), np.arange(3, 12).reshape(3, 3))
