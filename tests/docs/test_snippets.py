"""Snippets of README and the documentation run as printed, on small recordings, in one folder per page.

``bash`` blocks and ``run`` steps of ``yaml`` blocks run in a shell, ``python`` blocks in Python. Blocks with
file contents (``toml``, ``json``, ``csv``, gates) go to the matching reader; ``text`` blocks are diagrams.
Blocks that are not run carry their reason and are listed in ``NOT_RUN``. ``docs/reference`` is generated;
its examples are parsed in ``test_reference``.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.evaluation.judging.gates import read_gates
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.keypoints.file import read_keypoints
from posetrack_cli.head.landmarks.faces import read_landmarks
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results import load_arrays
from support.command_server import Warm, served_command
from support.markdown import PAGES, ROOT, Block, blocks
from support.snippets import (
    Place,
    filled_json,
    filled_table,
    link,
    write_boards,
    write_keypoints,
    write_video,
)

FRAMES, FEW = 8, 4
"""Of the recordings of README and the page Start; of all others."""
NOT_RUN = {
    ("README.md", "installs packages"): 1,
    ("README.md", "prepares a checkout"): 1,
    ("docs/index.md", "installs packages"): 1,
    ("docs/index.md", "prepares a checkout"): 1,
    ("docs/python.md", "installs packages"): 1,
    ("docs/batch.md", "needs Slurm"): 1,
    ("docs/ci.md", "needs Docker"): 1,
}
"""Blocks that are not run, by page and reason; ``test_setting_up`` runs those that prepare a checkout."""
CAMERA = Camera(512, 424, 365.0, 365.0, 255.5, 211.5)
"""What keypoints in the documentation may lie in."""
GENERATED = ROOT / "docs" / "reference"
TYPED = [path for path in PAGES if GENERATED not in path.parents]


@dataclass
class Made:
    """What pages are typed on, made once.

    Attributes:
        folder: ``depth.mcap``; ``face.mp4``, its first frames ``short.mp4`` and its result ``face.mcap``;
            ``few.mcap``, its images ``kinect`` and ``depth.npy``, its result ``hand.mcap``; ``rig``, images
            of two cameras without calibration, and ``boards`` for that; keypoints.
        newcomer: folder for the README's snippets.
    """

    folder: Path
    newcomer: Place

    def place(self, folder: Path) -> Place:
        """Another folder to type in."""
        return Place(folder, self.newcomer.commands, self.newcomer.synthesised)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Made]:
    folder, commands = tmp_path_factory.mktemp("made"), tmp_path_factory.mktemp("bin")
    with served_command(commands / "posetrack") as warm:
        newcomer = Place(tmp_path_factory.mktemp("newcomer"), commands, set())
        make(folder, Place(folder, commands, set()), warm)
        link(newcomer.folder, {name: folder / name for name in ("depth.mcap", "face.mp4")})
        yield Made(folder, newcomer)


def make(folder: Path, place: Place, warm: Warm) -> None:
    """Make what ``Made`` lists; compiled code is loaded on the way."""
    hand, head = (
        "posetrack hand synth --seed 1",
        "posetrack head synth --motion slight --light steady --seed 1",
    )
    for line in (
        f"{hand} -o depth.mcap --frames {FRAMES}",
        f"{hand} -o few.mcap --frames {FEW}",
        f"{head} -o made-rig --frames {FRAMES}",
    ):
        place.run(line)
    write_video(folder / "face.mp4", folder / "made-rig", "left", FRAMES)
    write_video(folder / "short.mp4", folder / "made-rig", "left", FEW)
    rig = open_recording(folder / "made-rig", "grey")
    write_boards(folder / "boards", rig.cameras, (10, 7), 25.0)
    for camera in rig.cameras:
        images = sorted((folder / "made-rig" / camera.name).iterdir())[:FEW]
        link(folder / "rig" / camera.name, {image.name: image for image in images})
    depths = [
        frame.depth.astype(np.uint16) for frame in open_recording(folder / "few.mcap", "depth").frames()
    ]
    np.save(folder / "depth.npy", np.stack(depths))
    (folder / "kinect").mkdir()
    for index, depth in enumerate(depths):
        cv2.imwrite(str(folder / "kinect" / f"{index}.png"), depth)
    stamps = (folder / "made-rig" / "timestamps.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    (folder / "rig" / "timestamps.csv").write_text("".join(stamps[: FEW + 1]), encoding="utf-8")
    files = {name: str(folder / name) for name in ("few.mcap", "hand.mcap", "face.mp4", "face.mcap")}
    warm([["hand", "run", files["few.mcap"], "-o", files["hand.mcap"]]])
    warm([["head", "mono", files["face.mp4"], "-o", files["face.mcap"], "--end", str(FEW)]])
    write_keypoints(folder / "hand.mcap", folder / "points.csv", folder / "mediapipe.json")


BOUND: Mapping[str, Mapping[str, str]] = {
    "README.md": {},
    "docs/index.md": {},
    "docs/hand.md": {
        "recording.mcap": "few.mcap",
        "mediapipe.json": "mediapipe.json",
        "points.csv": "points.csv",
    },
    "docs/head.md": {"boards": "boards", "recording": "rig", "face.mp4": "short.mp4"},
    "docs/recordings.md": {"boards": "boards", "recording": "rig", "kinect": "kinect"},
    "docs/results.md": dict.fromkeys(("result.mcap", "rbpf.mcap", "pf.mcap"), "hand.mcap")
    | {"few.mcap": "few.mcap"},
    "docs/eval.md": dict.fromkeys(("result.mcap", "rbpf.mcap", "pf.mcap"), "hand.mcap")
    | {f"out/{name}-{k}.mcap": "hand.mcap" for name in ("rbpf", "pf") for k in (1,)}
    | {f"results/{name}.mcap": "hand.mcap" for name in "ab"}
    | {"few.mcap": "few.mcap"},
    "docs/ci.md": {"recordings/one.mcap": "few.mcap"},
    "docs/batch.md": {"recordings/day1/a.mcap": "few.mcap"},
    "docs/python.md": {"hand.mcap": "hand.mcap", "face.mp4": "short.mp4", "depth.npy": "depth.npy"},
    "docs/exports.md": {"hand.mcap": "hand.mcap", "face.mcap": "face.mcap"},
    "docs/other-tools.md": {"hand.mcap": "hand.mcap", "face.mcap": "face.mcap", "depth.mcap": "few.mcap"},
}
"""Files that a page mentions, and the files in ``Made.folder`` that stand in for them."""


def folder_of_depth(text: str, folder: Path, made: Made) -> None:
    cv2.imwrite(str(folder / "0.png"), np.full((424, 512), 700, np.uint16))
    (folder / "camera.toml").write_text(text, encoding="utf-8")
    assert open_recording(folder, "depth", fps=30).cameras[0].fx == 365.0


def folder_of_two_cameras(text: str, folder: Path, made: Made) -> None:
    for name in ("left", "right"):
        (folder / name).mkdir()
        cv2.imwrite(str(folder / name / "0.png"), np.zeros((480, 640), np.uint8))
    (folder / "camera.toml").write_text(text, encoding="utf-8")
    assert open_recording(folder, "grey", fps=30).cameras[1].camera_T_reference[0][3] == -118.27


def manifest(text: str, folder: Path, made: Made) -> None:
    few = made.folder / "few.mcap"
    link(
        folder,
        {"kinect/a.mcap": few, "lab/left-hand.mcap": few, "lab/truth.csv": few, "lab/camera.toml": few},
    )
    (folder / "manifest.toml").write_text(text, encoding="utf-8")
    made.place(folder).run("posetrack batch hand run manifest.toml -o results/ --dry-run | grep lab/left")


def gates(text: str, folder: Path, made: Made) -> None:
    (folder / "gates.txt").write_text(text, encoding="utf-8")
    assert len(read_gates(folder / "gates.txt")) == len(text.splitlines())


def completion(text: str, folder: Path, made: Made) -> None:
    """Bash, which is there, runs its line; each shell's line gets what the shell then runs."""
    place = made.place(folder)
    for line in text.splitlines():
        (told,) = re.findall(r"_POSETRACK_COMPLETE=\w+_source posetrack", line)
        place.run(f"{told} | grep -q _POSETRACK_COMPLETE")
    place.run(f"{text.splitlines()[0]}\ncomplete -p posetrack")


def keypoints(text: str, folder: Path, made: Made) -> None:
    path = folder / ("k.json" if text[0] in "[{" else "k.csv")
    filled = (
        filled_json(text, 21) if path.suffix == ".json" else filled_table(text) if "..." in text else text
    )
    path.write_text(filled, encoding="utf-8")
    assert np.isfinite(read_keypoints(path, CAMERA).sets.points[..., 0]).sum() >= 3


def landmarks(text: str, folder: Path, made: Made) -> None:
    path = folder / ("l.json" if text[0] in "[{" else "l.csv")
    path.write_text(filled_json(text, 478) if path.suffix == ".json" else text, encoding="utf-8")
    assert len(read_landmarks(path, CAMERA).sets.points) == 1


READERS = {
    "docs/index.md": (completion,),
    "docs/recordings.md": (folder_of_depth, folder_of_two_cameras),
    "docs/batch.md": (manifest,),
    "docs/ci.md": (gates,),
    "docs/keypoints.md": (keypoints,) * 5,
    "docs/landmarks.md": (landmarks, landmarks),
}
"""Readers of a page's data blocks, in order; ``...`` in a block is expanded."""


def prepare_ci(place: Place, of_page: list[Block]) -> None:
    """The accuracy that the job is held against, and its gates: of one recording, not of 120."""
    (text,) = [block.text for block in of_page if not block.language]
    (place.folder / "accuracy").mkdir()
    (place.folder / "accuracy" / "gates.txt").write_text(text.replace("120", "1"), encoding="utf-8")
    place.type(next(block for block in of_page if "cp results/summary.json" in block.text))
    for name, script in STAND_INS.items():
        (place.commands / name).write_text(f"#!/bin/bash\n{script}\n")
        (place.commands / name).chmod(0o755)


STAND_INS = {
    "docker": 'while [ "$1" != "$IMAGE" ]; do shift; done; shift; exec posetrack "$@"',
    "gh": '[ "$1 $2 $3 $4" = "pr comment 7 --body-file" ] && grep -q "^|" "$5"',
}
"""Commands of a CI machine: the image's entry point without a container, and one that checks a comment."""


def prepare_batch(place: Place, of_page: list[Block]) -> None:
    """The batch itself; what it says of all serves as the baseline of the next."""
    place.type(next(block for block in of_page if block.language == "bash" and block.reason is None))
    place.run("mkdir accuracy && cp results/summary.json accuracy/baseline.json")
    place.run("echo 'coverage < 0.5' > accuracy/gates.txt")


PREPARED = {"docs/ci.md": prepare_ci, "docs/batch.md": prepare_batch}


ONE_SCRIPT = {"docs/python.md"}
"""Pages whose Python blocks continue each other."""


def is_typed(block: Block) -> bool:
    return block.language in ("bash", "python", "yaml") and block.reason is None


def is_data(block: Block) -> bool:
    return not is_typed(block) and block.reason is None and block.language != "text"


def page_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def type_page(path: Path, place: Place) -> None:
    typed = [block for block in filter(is_typed, blocks(path)) if all(map(find_spec, block.needs))]
    if page_of(path) in ONE_SCRIPT:
        typed = [replace(typed[0], text="\n".join(block.text for block in typed))]
    for block in typed:
        place.type(block)


def test_nothing_else_is_left_out() -> None:
    every = [block for path in TYPED for block in blocks(path)]
    assert Counter((block.page, block.reason) for block in every if block.reason) == NOT_RUN
    assert {block.page for block in every if is_typed(block)} == set(BOUND)
    data = Counter(block.page for block in every if is_data(block))
    assert data == {page: len(readers) for page, readers in READERS.items()}


def test_recipes_of_the_readme_work(made: Made) -> None:
    place = made.newcomer
    assert len([block for block in blocks(ROOT / "README.md") if is_typed(block)]) == 3
    type_page(ROOT / "README.md", place)
    for name in ("face", "hand"):
        result = load_arrays(place.folder / f"{name}.mcap")
        assert len(result["position"]) == FRAMES
        assert np.mean(result["status"] == "tracking") > 0.9
        page = (place.folder / f"{name}.html").read_text(encoding="utf-8")
        assert page.lower().startswith("<!doctype html>")
        with av.open(str(place.folder / f"{name}-tracked.mp4")) as video:
            assert sum(1 for _ in video.decode(video=0)) == FRAMES
    # The gate's exit code means something: asked for the impossible it is 1.
    assert run(["eval", str(place.folder / "hand.mcap"), "--fail-if", "joint_error_mm.mean > 0"]) == 1


def test_the_page_start_works(made: Made) -> None:
    """In the same folder: what it has in common with README is done."""
    type_page(ROOT / "README.md", made.newcomer)
    type_page(ROOT / "docs" / "index.md", made.newcomer)
    assert (made.newcomer.folder / "hand.csv").stat().st_size > 0
    assert (made.newcomer.folder / "made-head" / "camera.toml").is_file()


OTHERS = [path for path in TYPED if page_of(path) in BOUND and BOUND[page_of(path)]]


@pytest.mark.parametrize("path", OTHERS, ids=page_of)
def test_what_a_page_says_to_type_works(path: Path, made: Made, tmp_path: Path) -> None:
    page, place = page_of(path), made.place(tmp_path)
    link(tmp_path, {name: made.folder / source for name, source in BOUND[page].items()})
    if page in PREPARED:
        PREPARED[page](place, blocks(path))
    type_page(path, place)


@pytest.mark.parametrize("page", READERS)
def test_files_in_the_text_are_read(page: str, made: Made, tmp_path: Path) -> None:
    data = list(filter(is_data, blocks(ROOT / page)))
    for number, (block, reader) in enumerate(zip(data, READERS[page], strict=True)):
        (tmp_path / str(number)).mkdir()
        reader(block.text, tmp_path / str(number), made)
