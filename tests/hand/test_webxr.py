"""Hands from glTF files: our own hand written as GLB comes back as it was; damage is told in a line."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from posetrack_cli.errors import UsageError
from posetrack_cli.hand.config import HandSettings
from posetrack_cli.hand.model.anatomy import HandAnatomy, HandShape, make_anatomy
from posetrack_cli.hand.model.hand import HandModel, hand_maker, hand_mesh, hand_model
from posetrack_cli.hand.model.kinematics import joint_positions, skinning_transforms
from posetrack_cli.hand.model.webxr import load_hand
from posetrack_cli.rendering.gltf import read_glb
from posetrack_cli.rendering.mesh import closest_points, is_closed
from support.glb import GlbWriter, hand_glb, joint_names, write_hand
from support.hand import enclosed_volume, posed_from, random_poses

FLOAT32_MM = 1e-3
"""Positions in a file are float32 metres: 0.3 m times 6e-8, and skinning transforms are float32 at 0.1 m."""
RING_MM = 2.0
"""To either side of a joint: as far apart as the vertices of the finest skin are."""
LENGTHS, WIDTHS = (1.05, 0.95, 1.0, 1.1, 0.9), (1.1, 0.9, 1.0, 1.0, 1.2)
SHAPED = make_anatomy("right", 1.1, LENGTHS, WIDTHS)
AXES = posed_from(np.array([30.0, -40.0, 120.0]), np.array([1.1, -0.7, 2.0]), np.zeros(15))
FINGERS_RELAXED = ((0.3, 0.08, 0.4), (0.35, -0.02, 0.45), (0.4, -0.06, 0.5), (0.5, -0.1, 0.5))
RELAXED = np.concatenate([AXES[:7], [0.1, 0.3, 0.05], *FINGERS_RELAXED])


def made(path: Path, side: str = "right", shape: HandShape | None = None) -> HandModel:
    return hand_maker(str(path))(side, shape or HandShape())


def distances(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Of points from the nearest of others, mm."""
    return np.asarray(cKDTree(others).query(points)[0])


def surface_distances(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Of points from the nearest of triangles (T, 3, 3), mm."""
    triangle, shares = closest_points(points, corners)
    return np.linalg.norm(np.einsum("nc,ncx->nx", shares, corners[triangle]) - points, axis=1)


def same_bones(found: HandAnatomy, wanted: HandAnatomy) -> None:
    """Tips, too: they lie where the file has them, not where its skin ends."""
    np.testing.assert_allclose(found.base_positions, wanted.base_positions, atol=FLOAT32_MM)
    np.testing.assert_allclose(found.base_rotations, wanted.base_rotations, atol=1e-12)
    np.testing.assert_allclose(found.segments, wanted.segments, atol=FLOAT32_MM)
    assert found.scale == pytest.approx(wanted.scale, abs=1e-5)


@pytest.mark.parametrize("chained", [True, False], ids=["chained", "flat"])
@pytest.mark.parametrize("pose", [AXES, RELAXED], ids=["open", "relaxed"])
def test_the_bones_come_back_whatever_the_axes_and_the_rest_pose(
    tmp_path: Path, pose: np.ndarray, chained: bool
) -> None:
    found = load_hand(write_hand(tmp_path / "right.glb", SHAPED, pose, chained=chained)).anatomy
    same_bones(found, SHAPED)
    poses = random_poses(5)
    joints = joint_positions(SHAPED, poses)
    np.testing.assert_allclose(joint_positions(found, poses), joints, atol=3 * FLOAT32_MM)


def test_the_skin_of_an_open_hand_comes_back_vertex_by_vertex_and_closed(tmp_path: Path) -> None:
    mesh = hand_mesh(SHAPED, "medium")
    found = load_hand(write_hand(tmp_path / "right.glb", SHAPED, AXES)).skin
    assert is_closed(found.triangles)
    assert len(found.vertices) == len(mesh.vertices)  # those doubled at seams are one again
    before_wrist = mesh.vertices[:, 1] < 8.0 * SHAPED.scale - FLOAT32_MM
    assert distances(mesh.vertices[before_wrist], found.vertices).max() < 3 * FLOAT32_MM
    assert found.vertices[:, 1].max() < 8.0 * SHAPED.scale + FLOAT32_MM  # behind it the forearm begins
    nearest = cKDTree(found.vertices).query(mesh.vertices[before_wrist])[1]
    np.testing.assert_allclose(found.weights[nearest], mesh.weights[before_wrist], atol=1e-6)


def test_a_bent_hand_s_skin_is_straightened(tmp_path: Path) -> None:
    mesh = hand_mesh(SHAPED, "medium")
    found = load_hand(write_hand(tmp_path / "right.glb", SHAPED, RELAXED)).skin
    off = distances(mesh.vertices, found.vertices)
    rigid = (mesh.weights.max(axis=1) > 0.999) & (mesh.vertices[:, 1] < 8.0)
    assert rigid.sum() > 100
    assert off[rigid].max() < 3 * FLOAT32_MM
    # blending twice is no identity: between two bones 1 - cos(30 deg) of a radius may be lost each time
    assert off[mesh.vertices[:, 1] < 8.0].max() < 2.0 * (1.0 - np.cos(np.deg2rad(30.0))) * 14.0
    straight = load_hand(write_hand(tmp_path / "right.glb", SHAPED, AXES)).skin
    volumes = [enclosed_volume(m.vertices, m.triangles) for m in (found, straight)]
    assert volumes[0] == pytest.approx(volumes[1], rel=0.03)  # what blending loses at 14 bent joints


def test_radii_are_those_of_the_skin(tmp_path: Path) -> None:
    found = load_hand(write_hand(tmp_path / "right.glb", SHAPED, AXES)).anatomy
    mesh = hand_mesh(SHAPED, "fine")
    for finger in range(1, 5):
        local = (mesh.vertices - SHAPED.base_positions[finger]) @ SHAPED.base_rotations[finger]
        mine = mesh.weights[:, 1 + 3 * finger : 4 + 3 * finger].sum(axis=1) > 0.9
        for place, along in enumerate(np.cumsum(SHAPED.segments[finger])[:2], start=1):  # PIP and DIP
            ring = mine & (np.abs(local[:, 1] + along) < RING_MM)
            radius = np.hypot(local[ring, 0], local[ring, 2])
            # the median of a dozen vertices of those of the whole ring, whose centre the joint need not be
            assert radius.min() < found.radii[finger, place] < radius.max()
            assert found.radii[finger, place] == pytest.approx(radius.mean(), rel=0.3)


def test_a_left_hand_is_known_by_its_shape_and_mirrored(tmp_path: Path) -> None:
    left = make_anatomy("left", 1.1, LENGTHS, WIDTHS)
    path = write_hand(tmp_path / "hand.glb", left, RELAXED)
    same_bones(load_hand(path).anatomy, SHAPED)
    other = made(path, "left")
    assert other.anatomy.is_left
    same_bones(other.anatomy, left)
    assert enclosed_volume(other.smooth.vertices, other.smooth.triangles) > 0  # faces are outside still


def test_a_flat_hand_s_side_is_in_the_file_s_name(tmp_path: Path) -> None:
    flat = replace(SHAPED, base_positions=SHAPED.base_positions * [1.0, 1.0, 0.0])
    flat = replace(flat, base_rotations=np.tile(np.eye(3), (5, 1, 1)))
    same = [load_hand(write_hand(tmp_path / name, flat, AXES)) for name in ("my_right.glb", "left-hand.glb")]
    # what is laid out flat is its own mirror image, seen from the other side
    np.testing.assert_allclose(same[0].anatomy.segments, same[1].anatomy.segments, atol=FLOAT32_MM)
    with pytest.raises(UsageError, match=r"flat\.glb: side of a flat hand.*name the file right\.glb"):
        load_hand(write_hand(tmp_path / "flat.glb", flat, AXES))


def test_the_shape_s_factors_apply_on_top(tmp_path: Path) -> None:
    path = write_hand(tmp_path / "right.glb", make_anatomy(), AXES)
    shape = HandShape(1.1, LENGTHS, WIDTHS, 1.05, 0.95, 1.1)
    found, wanted = made(path, shape=shape), make_anatomy("right", 1.1, LENGTHS, WIDTHS, shape.palm)
    same_bones(found.anatomy, wanted)
    # the average hand's own shaping and stretching by bones differ only where bones blend
    off = distances(hand_mesh(wanted, "medium").vertices, found.smooth.vertices)
    assert np.percentile(off, 90) < 2.5
    twice = made(path, shape=HandShape(scale=2.0)).smooth.vertices
    np.testing.assert_allclose(twice, 2.0 * made(path).smooth.vertices, atol=1e-9)


def test_the_lean_skin_is_lean_and_near_the_whole(tmp_path: Path) -> None:
    path = write_hand(tmp_path / "right.glb", SHAPED, AXES, mesh=hand_mesh(SHAPED, "fine"))
    hand = hand_model(HandSettings(mesh=str(path)))
    assert len(hand.lean.triangles) <= 420 and len(hand.smooth.triangles) <= 1640
    assert len(hand.skin("fine").triangles) > 6000
    for mesh in (hand.lean, hand.smooth):
        assert mesh.weights.shape[1] == 16
        np.testing.assert_allclose(mesh.weights.sum(axis=1), 1.0, atol=1e-9)
        poses = random_poses(3)
        whole = hand.skin("fine").posed(skinning_transforms(hand.anatomy, poses).astype(np.float64))
        posed = mesh.posed(skinning_transforms(hand.anatomy, poses).astype(np.float64))
        for few, many in zip(posed, whole, strict=True):
            assert np.median(surface_distances(few, many[hand.skin("fine").triangles])) < 1.0


# What cannot be used


def damaged(tmp_path: Path, change: Callable[[dict[str, Any]], Any]) -> Path:
    """A hand's file after a change of its JSON."""
    writer = hand_glb(make_anatomy(), RELAXED)
    change(writer.content)
    path = tmp_path / "hand.glb"
    path.write_bytes(writer.bytes())
    return path


def one_line(path: Path, match: str) -> None:
    with pytest.raises(UsageError, match=match) as error:
        load_hand(path)
    assert str(error.value).startswith(str(path)) and "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["wrist", "thumb-tip", "ring-finger-metacarpal"])
def test_a_missing_joint_is_named(tmp_path: Path, name: str) -> None:
    names = [f"other {k}" if known == name else known for k, known in enumerate(joint_names())]
    one_line(
        write_hand(tmp_path / "hand.glb", make_anatomy(), RELAXED, names=names), f"lacks the joint '{name}'"
    )


def test_names_may_differ_in_case_and_hyphens(tmp_path: Path) -> None:
    names = [name.replace("-", "_").title() for name in joint_names()]
    load_hand(write_hand(tmp_path / "hand.glb", make_anatomy(), RELAXED, names=names))


@pytest.mark.parametrize("per_metre", [1.0, 10.0, 100000.0])
def test_other_units_are_told_by_the_hand_s_size(tmp_path: Path, per_metre: float) -> None:
    path = write_hand(tmp_path / "hand.glb", make_anatomy(), RELAXED, per_metre=per_metre)
    one_line(path, "implausible hand size.*metres")


def test_there_is_no_skin(tmp_path: Path) -> None:
    one_line(damaged(tmp_path, lambda content: content.pop("skins")), "no skinned mesh")
    one_line(damaged(tmp_path, lambda content: content["nodes"][0].pop("skin")), "no skinned mesh")


def test_compression_is_not_read(tmp_path: Path) -> None:
    needs = {"extensionsRequired": ["KHR_draco_mesh_compression"]}
    one_line(damaged(tmp_path, lambda content: content.update(needs)), "KHR_draco.*without compression")


def test_sparse_accessors_are_not_read(tmp_path: Path) -> None:
    one_line(damaged(tmp_path, lambda content: content["accessors"][0].update(sparse={})), "sparse")


def test_buffers_elsewhere_are_not_read(tmp_path: Path) -> None:
    buffers = [{"byteLength": 4, "uri": "hand.bin"}]

    def move(writer: dict[str, Any]) -> None:
        writer["extras"] = buffers

    path = damaged(tmp_path, move)
    text = path.read_bytes().replace(b'"buffers": [{"byteLength"', b'"buffers": [{"uri": "a", "byteLength"')
    length = struct.unpack_from("<I", text, 12)[0] + len(b'"uri": "a", ')
    path.write_bytes(text[:8] + struct.pack("<II", len(text), length) + text[16:])
    one_line(path, "external buffers.*one binary file")


@pytest.mark.parametrize(
    "change",
    [
        lambda content: content["accessors"][0].update(count=10**9),
        lambda content: content["accessors"][0].update(bufferView=99),
        lambda content: content["accessors"][0].update(componentType=1),
        lambda content: content["skins"][0].update(joints=[999]),
        lambda content: content["nodes"][1].update(rotation="none"),
        lambda content: content["meshes"][0]["primitives"][0]["attributes"].pop("POSITION"),
        lambda content: content["meshes"][0].pop("primitives"),
        lambda content: content.update(nodes=3),
    ],
)
def test_parts_that_do_not_fit_are_damage(tmp_path: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    one_line(damaged(tmp_path, change), "damaged")


def test_nodes_in_a_ring(tmp_path: Path) -> None:
    def close(content: dict[str, Any]) -> None:
        content["nodes"][3]["children"] = [2]

    one_line(damaged(tmp_path, close), "ring")


def test_triangles_of_vertices_that_are_not_there(tmp_path: Path) -> None:
    def shorten(content: dict[str, Any]) -> None:
        primitive = content["meshes"][0]["primitives"][0]
        for name in primitive["attributes"].values():
            content["accessors"][name]["count"] = 10

    one_line(damaged(tmp_path, shorten), "invalid triangle indices")


def test_lines_are_no_skin(tmp_path: Path) -> None:
    one_line(
        damaged(tmp_path, lambda content: content["meshes"][0]["primitives"][0].update(mode=1)), "triangles"
    )


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"", "not a GLB file"),
        (b"glTF", "not a GLB file"),
        (b'{"asset": {"version": "2.0"}}', "not a GLB file.*one binary file"),
        (struct.pack("<4sII", b"glTF", 1, 12), "unsupported glTF version, found 1"),
        (struct.pack("<4sII", b"glTF", 2, 12), "has no valid JSON"),
        (struct.pack("<4sIII4s", b"glTF", 2, 24, 4, b"JSON") + b"[1] ", "has no JSON object"),
    ],
)
def test_other_files(tmp_path: Path, content: bytes, match: str) -> None:
    path = tmp_path / "hand.glb"
    path.write_bytes(content)
    one_line(path, match)


def test_no_file(tmp_path: Path) -> None:
    one_line(tmp_path / "none.glb", "cannot be read")


@pytest.mark.parametrize("share", [0.001, 0.1, 0.5, 0.99])
def test_a_truncated_file(tmp_path: Path, share: float) -> None:
    data = hand_glb(make_anatomy(), RELAXED).bytes()
    path = tmp_path / "hand.glb"
    path.write_bytes(data[: int(share * len(data))])
    one_line(path, "truncated")


def test_integers_may_stand_for_shares(tmp_path: Path) -> None:
    writer = GlbWriter()
    shares = writer.accessor(np.array([[0, 51, 255, 0]], dtype="<u1"), 5121, "VEC4")
    writer.content["accessors"][shares]["normalized"] = True
    counts = writer.accessor(np.array([[0, 51, 255, 0]], dtype="<u1"), 5121, "VEC4")
    path = tmp_path / "numbers.glb"
    path.write_bytes(writer.bytes())
    gltf = read_glb(path)
    np.testing.assert_allclose(gltf.numbers(shares), [[0.0, 0.2, 1.0, 0.0]])
    np.testing.assert_array_equal(gltf.numbers(counts), [[0, 51, 255, 0]])
