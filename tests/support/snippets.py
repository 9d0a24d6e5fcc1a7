"""What snippets of the documentation are typed on: small recordings, and a shell in a folder of their own."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from posetrack_cli.evaluation.viewing.outputs import VideoFile
from posetrack_cli.geometry.camera import Camera, pixels_from_points
from posetrack_cli.hand.model.anatomy import JOINT_NAMES
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results import load_arrays, read_result
from support.command_server import TIMEOUT_S
from support.markdown import ROOT, Block, statements

INSTALLING = ("sudo apt-get ", "pip install ")
"""How steps of jobs begin that install packages, and are not run."""
JOB = {"GITHUB_STEP_SUMMARY": "shown.md", "IMAGE": "posetrack", "NUMBER": "7"}
"""Variables of a job."""
MADE_FRAMES = 3
"""Of recordings that the documentation has made: it says 300 where 3 show as well that the line works."""
_MADE = re.compile(r"posetrack (hand|head) synth\b")
_SAME_EVERYWHERE = re.compile(r"posetrack ((hand|head) synth|calibrate stereo)\b")
_WRITTEN = re.compile(r"(?<!\S)-o (\S+)")
RATE_HZ = 30.0


@dataclass
class Place:
    """A folder in which snippets are typed one after the other, and what was typed there already.

    Attributes:
        folder: it.
        commands: folder of the commands that come before the system's.
        synthesised: lines that made a recording or a calibration, here or elsewhere: once shows enough.
        typed: lines that were run, which stay done: results are not replaced.
        written: what lines wrote; another one that writes the same stands for an alternative.
    """

    folder: Path
    commands: Path
    synthesised: set[str]
    typed: set[str] = field(default_factory=set)
    written: set[str] = field(default_factory=set)

    def type(self, block: Block) -> None:
        """Run a block, as it stands there."""
        if block.language == "python":
            self._run([sys.executable, "-c", block.text], block.place)
            return
        for script in scripts(block):
            done = self.typed | self.synthesised
            lines = [line for line in map(_plain, statements(script)) if line not in done]
            self.typed.update(lines)
            self.synthesised.update(filter(_SAME_EVERYWHERE.match, lines))
            if lines:
                self.run("\n".join(self._free(line) for line in lines), block.place)

    def run(self, script: str, where: str = "") -> None:
        """Have a shell run lines that no page has."""
        self._run(["bash", "-euo", "pipefail", "-c", script], where or script)

    def _free(self, line: str) -> str:
        """A line that makes few frames; of an option that is given twice the last one counts."""
        if _MADE.match(line):
            line = f"{line} --frames {MADE_FRAMES}"
        written = set() if " batch " in line else set(_WRITTEN.findall(line))
        again, self.written = written & self.written, written | self.written
        return f"rm -r {' '.join(again)}\n{line}" if again else line

    def _run(self, command: list[str], where: str) -> None:
        own = {"PATH": f"{self.commands}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
        ran = subprocess.run(
            command,
            cwd=self.folder,
            env=os.environ | own | JOB,
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
        )
        assert ran.returncode == 0, f"{where}: exit code {ran.returncode}\n{ran.stdout}{ran.stderr}"


def _plain(line: str) -> str:
    """A line without the comment behind it."""
    return line.split("  #", 1)[0].rstrip()


def scripts(block: Block) -> list[str]:
    """What a block has a shell run: all of it, or the steps of a job."""
    return list(_steps(yaml.safe_load(block.text))) if block.language == "yaml" else [block.text]


def _steps(value: Any) -> Iterator[str]:
    for each in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        yield from _steps(each)
    if isinstance(value, dict):
        found = [value.get("run"), *value.get("script", ())]
        yield from (one for one in found if isinstance(one, str) and not one.startswith(INSTALLING))


def link(folder: Path, bound: Mapping[str, Path]) -> None:
    """Put copies of files and folders where a page has its own."""
    for name, source in bound.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (shutil.copytree if source.is_dir() else shutil.copy)(source, folder / name)


def write_video(path: Path, recording: Path, camera: str, count: int) -> None:
    """A video of the first frames that one camera sees."""
    video = VideoFile(path, RATE_HZ)
    for frame in open_recording(recording, "grey", cameras=[camera]).frames(end=count):
        video.add(frame.index, cv2.cvtColor(np.asarray(frame.images[0], np.uint8), cv2.COLOR_GRAY2BGR))
    video.close()


def write_boards(folder: Path, rig: Sequence[Camera], squares: tuple[int, int], square_mm: float) -> None:
    """Images of a chessboard in six places, by the homography of each; the cameras distort nothing."""
    texels = 20
    columns, rows = squares
    board = np.kron(np.add.outer(np.arange(rows), np.arange(columns)) % 2 * 255, np.ones((texels, texels)))
    framed = np.pad(board, texels, constant_values=255).astype(np.uint8)
    mm = square_mm / texels
    from_texels = np.array(
        [[mm, 0, -mm * framed.shape[1] / 2], [0, mm, -mm * framed.shape[0] / 2], [0, 0, 1]]
    )
    for camera in rig:
        (folder / camera.name).mkdir(parents=True)
        transform = np.array(camera.camera_T_reference)
        for index in range(6):
            turn = cv2.Rodrigues(np.array([0.5 * np.sin(index), 0.5 * np.cos(2.0 * index), 0.1 * index]))[0]
            place = np.array([12.0 * index - 30.0, 20.0 * np.cos(index), 700.0 + 20.0 * index])
            pose = np.column_stack([turn[:, :2], place])
            seen = transform[:, :3] @ pose
            seen[:, 2] += transform[:, 3]
            homography = camera.matrix @ seen @ from_texels
            size = (camera.width, camera.height)
            image = cv2.warpPerspective(framed, homography, size, flags=cv2.INTER_AREA, borderValue=128)
            cv2.imwrite(str(folder / camera.name / f"{index}.png"), cv2.GaussianBlur(image, (3, 3), 0))


def write_keypoints(result: Path, csv: Path, mediapipe: Path) -> None:
    """The joints of a result as another program would have found them: pixels, and shares of the image."""
    camera, points = read_result(result).camera(), load_arrays(result)["points"]
    pixels, _ = pixels_from_points(camera, points.reshape(-1, 3))
    frames = pixels.reshape(len(points), -1, 2)
    rows = [f"{k},{j},{x:.2f},{y:.2f}" for k, hand in enumerate(frames) for j, (x, y) in enumerate(hand)]
    csv.write_text("\n".join(["frame,landmark,x,y", *rows]) + "\n", encoding="utf-8")
    shares = (frames / [camera.width, camera.height]).tolist()
    said = [
        {"frame": k, "handLandmarks": [[{"x": x, "y": y, "z": 0.0} for x, y in hand]]}
        for k, hand in enumerate(shares)
    ]
    mediapipe.write_text(json.dumps(said), encoding="utf-8")


def filled_json(text: str, count: int) -> str:
    """JSON in which ``...`` stands for the rest of a list, with a rest: as many points as there must be."""

    def filled(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: filled(each) for key, each in value.items()}
        if not isinstance(value, list) or not value:
            return value
        *begun, last = map(filled, value)
        if last != "...":
            return [*begun, last]
        if not begun:
            return [[250.0, 300.0]] * count
        if isinstance(begun[0], str):
            return list(JOINT_NAMES)
        each = 3 if isinstance(begun[0], float) else 1  # x, y, v one after the other
        return [*begun, *(begun[-each:] * (count - len(begun) // each))]

    return json.dumps(filled(json.loads(re.sub(r"\.\.\.", '"..."', text))))


def filled_table(text: str) -> str:
    """A table of 21 points, of which the middle ones are ``...``."""
    head, row = text.strip().splitlines()
    middle = [f"{axis}{k}" for k in range(3, 20) for axis in "xy"]
    return "\n".join(
        [head.replace("...", ",".join(middle)), row.replace("...", ",".join(["260.0"] * len(middle)))]
    )
