"""Recordings of strangers' hands as other sensors see them, with ground truth.

``python -m research.hand_sensors OUT --sensor d435 --people 800-807`` writes folders ``OUT/d435-800`` with
``depth/`` and ``truth.csv``, for ``hand run`` and ``eval --truth``. People and motions are
those of ``reproduce hand-strangers``, rendered with the sensor's camera before a body and a wall. ``--track``
also tracks them and prints errors, lengths and intervals.
"""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType
from typing import Any

import click
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.evaluation.measuring.catalogue import figure_of
from posetrack_cli.evaluation.measuring.evaluate import EvalOptions
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import HandSettings
from posetrack_cli.hand.model.hand import hand_model
from posetrack_cli.hand.shape_fit import measures_of
from posetrack_cli.recording.image_files import encode_png
from posetrack_cli.synthesis.hand.frames import quantised
from posetrack_cli.synthesis.hand.sensors import SENSORS
from research import hands
from research.hand_accuracy import NO_MESH
from research.hand_strangers import Person, people_of
from research.runner import SHARED, command

PNG_LEVEL = 1


def tool_of(path: Path, camera: Camera) -> ModuleType:
    """Load foreign_hand.py, set to render with a camera; OpenGL's first pixel spans 0 to 1."""
    spec = importlib.util.spec_from_file_location("foreign_hand", path)
    assert spec is not None and spec.loader is not None
    tool: Any = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    tool.WIDTH, tool.HEIGHT, tool.FOCAL = camera.width, camera.height, camera.fx
    tool.CX, tool.CY = camera.cx + 0.5, camera.cy + 0.5
    return tool  # type: ignore[no-any-return]


def behind(camera: Camera, *, mirrored: bool) -> FloatArray:
    """Return the depth of foreign_hand.py's body and wall, mm, which it places in a Kinect v2's pixels."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    x = 365.0 * (u - camera.cx) / camera.fx * (-1.0 if mirrored else 1.0) + 256.0
    y = 365.0 * (v - camera.cy) / camera.fy + 212.0
    trunk = ((x - 300.0) / 85.0) ** 2 + ((y - 330.0) / 150.0) ** 2 < 1.0
    head = ((x - 300.0) / 32.0) ** 2 + ((y - 140.0) / 42.0) ** 2 < 1.0
    return np.where(head, 1180.0, np.where(trunk, 1250.0, 2300.0 + 0.3 * (y - 212.0)))


def draw(tool: Any, person: Person, frames: int, sensor_name: str, out: Path) -> None:
    """Write the recording of a person: folder, camera, stamps and joints."""
    sensor, mirrored = SENSORS[sensor_name], person.side == "left"
    hand, motion = tool.Hand(tool.draw_person(person.number)), tool.Motion(person.number, frames, 1.0)
    renderer = tool.Renderer(
        np.concatenate([hand.triangles, tool.tube(len(hand.vertices))]), len(hand.vertices) + 2 * tool.RING
    )
    rng, background = (
        np.random.default_rng([79, person.number, person.number]),
        behind(sensor.camera, mirrored=mirrored),
    )
    flip, rows = np.array([-1.0 if mirrored else 1.0, 1.0, 1.0]), []
    (out / "depth").mkdir(parents=True, exist_ok=True)
    for k in range(frames):
        vertices, joints = posed(tool, hand, motion, k, shows_back=person.shows_back)
        clean: Float32Array = renderer.draw(vertices * flip)
        ideal = np.where(clean > 0.0, clean, background).astype(np.float32)
        readings = quantised(sensor.readings(ideal, rng, mirrored=mirrored))
        (out / "depth" / f"{k:06d}.png").write_bytes(encode_png(readings, PNG_LEVEL))
        rows.append([motion.t[k], *(joints * flip).ravel()])
    camera = "".join(f"{name} = {getattr(sensor.camera, name)}\n" for name in ("fx", "fy", "cx", "cy"))
    (out / "depth" / "camera.toml").write_text(camera, encoding="utf-8")
    stamps = "".join(f"{k:06d}.png,{round(t * 1e9)}\n" for k, t in enumerate(motion.t))
    (out / "depth" / "timestamps.csv").write_text(f"filename,stamp_ns\n{stamps}", encoding="utf-8")
    header = "stamp_ns," + ",".join(f"{joint}_{axis}_mm" for joint in tool.TRUTH for axis in "xyz")
    tool.write_rows(out / "truth.csv", header, rows)


def posed(tool: Any, hand: Any, motion: Any, k: int, *, shows_back: bool) -> tuple[FloatArray, FloatArray]:
    """Return vertices (V, 3) of hand and arm, and joints (21, 3), of a right hand in frame k, mm."""
    side = np.cross(hand.up, hand.normal)
    base = np.array([-side, -hand.up, -hand.normal])
    base[0] *= np.sign(np.linalg.det(base))
    base = tool.rotation((0, 1, 0), np.pi) @ base if shows_back else base
    angles, spread = (
        motion.angles[k].reshape(5, 3),
        zip(tool.FINGERS[1:], (-1.2, -0.2, 0.7, 1.6), strict=True),
    )
    flexion = {f"{f}_0{n + 1}": angles[m, n] for m, f in enumerate(tool.FINGERS) for n in range(3)}
    abduction = {f"{finger}_01": motion.spread[k] * share for finger, share in spread}
    turn = tool.rotation((0, 1, 0), motion.yaw[k]) @ tool.rotation((1, 0, 0), motion.pitch[k])
    turn = turn @ tool.rotation((0, 0, 1), motion.roll[k]) @ base
    vertices, joints, elbow = (
        (points - hand.joints["hand"]) @ turn.T + motion.position[k]
        for points in hand.posed(flexion, abduction, motion.wrist[k])
    )
    return np.concatenate([vertices, tool.upper_arm(elbow)]), joints


def figures_of(folder: Path) -> str:
    """Track a recording; return its errors, lengths against the truth's, and coverage of intervals as a line.

    The length from the wrist includes the rig's definition of the wrist, the middle finger's does not.
    """
    result, truth = folder / "result.mcap", folder / "truth.csv"
    command("hand", "run", str(folder / "depth"), "-o", str(result), "--overwrite", "--hands", "1", *NO_MESH)
    raw, moved = (
        hands.evaluated(result, EvalOptions(truth=truth, joint_offsets=offsets)) for offsets in (None, "bone")
    )
    hand = hand_model(HandSettings.model_validate(json.loads(raw.run["configuration"])["hand"])).anatomy
    assert raw.truth is not None and raw.truth.points is not None
    joints = dict(zip(raw.truth.point_names, raw.truth.points[0], strict=True))
    chain = [joints[name] for name in ("wrist", *(f"middle_{part}" for part in ("mcp", "pip", "dip", "tip")))]
    bones = np.linalg.norm(np.diff(chain, axis=0), axis=1)
    lengths = measures_of(hand)[[0, 5]] / (bones.sum(), bones[1:].sum()) - 1.0
    parts = [(moved, "joint_error_mm.mean"), (raw, "fingertip_error_mm.mean")]
    error, tips, inside, inside_moved, lost = (
        figure_of(of, name).value
        for of, name in (*parts, (raw, "joint_inside_90"), (moved, "joint_inside_90"), (raw, "lost"))
    )
    return (
        f"{folder.name}: {error:.2f} mm after offsets, fingertips {tips:.2f} mm, length {lengths[0]:+.1%}, "
        f"middle finger {lengths[1]:+.1%}, inside 90 % {inside:.2f} raw, {inside_moved:.2f} after offsets, "
        f"{lost:.0f} lost"
    )


@click.command(help=__doc__)
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--sensor", type=click.Choice(sorted(SENSORS)), required=True, help="Simulated sensor.")
@click.option("--people", default="20-27", show_default=True, help="People, e.g. 20-27,800.")
@click.option("--frames", default=90, show_default=True, help="Frames per recording.")
@click.option("--tool", type=click.Path(path_type=Path), default=SHARED / "tools" / "foreign_hand.py")
@click.option("--track", is_flag=True, help="Track the recordings and print figures.")
def main(out: Path, sensor: str, people: str, frames: int, tool: Path, *, track: bool) -> None:
    """Write the recordings."""
    loaded = tool_of(tool, SENSORS[sensor].camera)
    for person in people_of(people, final=False):
        folder = out / f"{sensor}-{person.number}"
        draw(loaded, person, frames, sensor, folder)
        if track:
            click.echo(figures_of(folder))


if __name__ == "__main__":
    main()
