"""SHA-256 of every file that the commands write, over recordings that they make themselves.

Every step is a command line as a user types it, in a folder of its own with relative names: nothing but
the code and the machine decides what is written. Two runs on one machine give the same digests; runs
before and after a change of the code therefore show whether any result changed.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import click
import cv2
import numpy as np

from posetrack_cli.outputs import state_path

POSETRACK = (sys.executable, "-m", "posetrack_cli.cli.main")
FLUSH = ("--set", "output.flush_frames=5")
INTERRUPTED_S = 600.0
"""Within so many seconds a run must have written the state that it is interrupted after."""


@dataclass(frozen=True)
class Step:
    """A command line and what of it is digested.

    Attributes:
        name: unique.
        arguments: of ``posetrack``; ``{name}`` stands for the first output of the step of that name.
        outputs: files or folders that it writes; none if only its standard output counts.
        interrupted: whether it is stopped by Ctrl-C after its first checkpoint and resumed.
        codes: exit codes that it may end with.
    """

    name: str
    arguments: tuple[str, ...]
    outputs: tuple[str, ...] = ()
    interrupted: bool = False
    codes: tuple[int, ...] = (0,)
    printed: bool = field(default=False)


def _step(name: str, line: str, *outputs: str, interrupted: bool = False, printed: bool = False) -> Step:
    return Step(name, tuple(line.split()), outputs, interrupted, (0, 1, 3) if printed else (0, 3), printed)


def recordings() -> Iterator[Step]:
    """Yield the steps that make recordings, and convert them."""
    hand, head = "hand synth --frames 40 --seed 3 -o", "head synth --frames 60 --identity 2 --seed 4 -o"
    for motion in "ABC":
        yield _step(f"hand-{motion}", f"{hand} hand-{motion}.mcap --motion {motion}", f"hand-{motion}.mcap")
    yield _step("hand-left", f"{hand} hand-left.mcap --hand-side left --random-hand", "hand-left.mcap")
    yield _step("hand-bare", f"{hand} bare.mcap --no-body --no-background --no-drops", "bare.mcap")
    yield _step("hand-long", "hand synth --frames 150 --random-hand --seed 5 -o long.mcap", "long.mcap")
    yield _step("head-two", f"{head} two.mcap", "two.mcap")
    yield _step("head-one", f"{head} one.mcap --camera-count 1 --lens-distortion", "one.mcap")
    yield _step("head-folder", f"{head} faces --image-format png", "faces")
    yield _step(
        "head-drops", f"{head} drops.mcap --drops --occlusion --light sudden --lens-distortion", "drops.mcap"
    )
    yield _step("head-motions", f"{head} motions.mcap --script two-motions --motion still", "motions.mcap")
    yield _step("convert-mcap", "convert {hand-C} -o converted.mcap", "converted.mcap")
    yield _step("convert-folder", "convert depth -o depth.mcap --fps 30", "depth.mcap")


def hand_runs() -> Iterator[Step]:
    """Yield runs of every hand tracker."""
    runs = {
        "rbpf": "{hand-C}",
        "auto-left": "{hand-left}",
        "smooth": "{hand-C} --smooth",
        "pf": "{hand-C} --filter pf",
        "pf-smooth": "{hand-B} --filter pf --smooth",
        "pso": "{hand-C} --filter pso --particles 16 --end 12",
        "fast": "{hand-C} --config hand-fast",
        "paper": "{hand-B} --config hand-paper --particles 128 --init center",
        "annealed": "{hand-B} --proposal annealed --particles 128 --end 20",
        "marginal": "{hand-A} --proposal marginal",
        "multinomial": "{hand-A} --resampling multinomial --cost paper --particles 64",
        "own-shape": "{hand-long} --end 40",
        "folder": "depth --fps 30 --hand-side right --scale 1.02 --stride 2 --seed 7",
        "mirror": "{hand-bare} --mirror --init center --end 15",
        "started": "{hand-C} --init {rbpf} --start 5 --end 20",
    }
    for name, line in runs.items():
        yield _step(name, f"hand run {line} -o {name}.mcap", f"{name}.mcap")
    for name in ("rbpf", "smooth"):
        line = f"hand run {runs[name]} -o {name}-resumed.mcap"
        yield _step(f"{name}-resumed", f"{line} {' '.join(FLUSH)}", f"{name}-resumed.mcap", interrupted=True)
    yield _step("hand-toml", "hand calibrate {hand-long} -o hand.toml", "hand.toml")
    yield _step("shaped", "hand run {hand-long} --shape hand.toml --end 20 -o shaped.mcap", "shaped.mcap")


def head_runs() -> Iterator[Step]:
    """Yield runs of both head trackers."""
    runs = {
        "stereo-one": "stereo {head-two} --passes 1 --save-model stereo.npz",
        "stereo-two": "stereo {head-two} --passes 2",
        "stereo-rigid": "stereo {head-drops} --model rigid --passes 1 --seed 3",
        "stereo-folder": "stereo faces --fps 30 --stride 2",
        "stereo-loaded": "stereo {head-two} --load-model stereo.npz --start 20 --passes 1",
        "stereo-paper": "stereo {head-two} --config head-stereo-paper --end 30",
        "mono-one": "mono {head-one} --passes 1 --save-model mono.npz",
        "mono-two": "mono {head-one} --passes 2",
        "mono-start": "mono {head-two} --cameras left --adjust start",
        "mono-never": "mono {head-one} --adjust never --passes 1",
        "mono-loaded": "mono {head-one} --load-model mono.npz --passes 1",
        "mono-guess": "mono uncalibrated --fov 50 --fps 30 --passes 1",
        "mono-paper": "mono {head-one} --config head-mono-paper --passes 1",
    }
    saved = {"stereo-one": ("stereo.npz",), "mono-one": ("mono.npz",)}
    for name, line in runs.items():
        yield _step(name, f"head {line} -o {name}.mcap", f"{name}.mcap", *saved.get(name, ()))
    for name in ("stereo-two", "mono-two"):
        line = f"head {runs[name]} -o {name}-resumed.mcap {' '.join(FLUSH)}"
        yield _step(f"{name}-resumed", line, f"{name}-resumed.mcap", interrupted=True)
    learnt = "motions.mcap --passes 1 --set model.components=3"
    yield _step("motions", f"head stereo {learnt} -o motions-result.mcap", "motions-result.mcap")


def readings() -> Iterator[Step]:
    """Yield what is said, measured, drawn and exported of results."""
    for name in ("hand-C", "head-two", "head-one", "smooth", "pso", "stereo-two", "mono-two"):
        yield _step(f"info-{name}", f"info {{{name}}} --json -", printed=True)
        yield _step(f"info-text-{name}", f"info {{{name}}}", printed=True)
    for name in ("depth", "faces"):
        yield _step(f"info-{name}", f"info {name} --json -", printed=True)
    measured = {
        "rbpf": "--truth {hand-C} --recording {hand-C}",
        "smooth": "--truth {hand-C} --track both --joint-offsets palm --parts",
        "auto-left": "--truth {hand-left} --align rigid",
        "paper": "--fail-if joint_error_mm.mean>1",
        "stereo-two": "--truth {head-two} --align rigid+points --parts",
        "mono-two": "--truth {head-one} --align rigid",
        "rbpf {pf} {fast}": "--truth {hand-C}",
    }
    for names, line in measured.items():
        name = names.split()[0].strip("{}") + ("-compared" if " " in names else "")
        results = " ".join(f"{{{n.strip('{}')}}}" for n in names.split())
        written = [f"{name}.eval.{kind}" for kind in ("json", "csv", "html")]
        options = " ".join(
            f"--{kind} {path}" for kind, path in zip(("json", "csv", "html"), written, strict=True)
        )
        yield Step(
            f"eval-{name}",
            (*f"eval {results} {line} {options}".split(),),
            (*written,),
            False,
            (0, 1, 3),
            True,
        )
    yield _step("metrics", "eval --list-metrics", printed=True)
    for name in ("smooth", "stereo-two", "mono-two"):
        for kind in ("csv", "tum", "json", "npz"):
            yield _step(f"export-{name}-{kind}", f"export {{{name}}} -o {name}.{kind}", f"{name}.{kind}")
    yield _step("export-smoothed", "export {smooth} --track smoothed -o smoothed.csv", "smoothed.csv")
    seen = {
        "rbpf": "--recording {hand-C} --show-truth --skeleton",
        "smooth": "--recording {hand-C} --track both --layout over",
        "stereo-two": "--recording {head-two} --show-truth",
        "mono-two": "--recording {head-one} --crop head",
    }
    for names, line in seen.items():
        name = names.split()[0]
        results = " ".join(f"{{{n.strip('{}')}}}" for n in names.split())
        yield _step(f"view-{name}", f"view {results} {line} --select 3,10,25 -o {name}-view", f"{name}-view")
    yield _step(
        "view-segments", "view {rbpf} --layout segments --select spread:4 -o segments.png", "segments.png"
    )


GROUPS = {"recordings": recordings, "hand": hand_runs, "head": head_runs, "readings": readings}


class Workplace:
    """A folder in which the steps are done, one after the other.

    Args:
        folder: for everything that they write.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._outputs: dict[str, str] = {}

    def digest(self, step: Step) -> Mapping[str, str]:
        """Do a step; return the digests of what it wrote, by name.

        Raises:
            click.ClickException: it ended with another exit code than it may.
        """
        arguments = [re.sub(r"\{(.+?)\}", lambda m: self._outputs[m[1]], text) for text in step.arguments]
        if step.interrupted:
            self._interrupt(arguments, step)
            arguments.append("--resume")
        ended = subprocess.run([*POSETRACK, *arguments], cwd=self._folder, capture_output=True, check=False)
        if ended.returncode not in step.codes:
            said = ended.stderr.decode(errors="replace").strip().splitlines()[-3:]
            raise click.ClickException(f"{step.name}: exit code {ended.returncode}: {' / '.join(said)}")
        digests = {"exit code": str(ended.returncode)}
        if step.printed:
            digests["standard output"] = digest_of(ended.stdout)
        if step.outputs:
            self._outputs[step.name] = step.outputs[0]
        for name in step.outputs:
            digests |= {
                str(p.relative_to(self._folder)): digest_of(p.read_bytes())
                for p in files_of(self._folder / name)
            }
        return digests

    def _interrupt(self, arguments: Sequence[str], step: Step) -> None:
        """Start a run and stop it as Ctrl-C does once it can be resumed."""
        state = state_path(self._folder / step.outputs[0])
        null = subprocess.DEVNULL
        with subprocess.Popen([*POSETRACK, *arguments], cwd=self._folder, stdout=null, stderr=null) as run:
            until = time.monotonic() + INTERRUPTED_S
            while not state.exists():
                if run.poll() is not None or time.monotonic() > until:
                    raise click.ClickException(f"{step.name}: ended before it could be interrupted")
                time.sleep(0.02)
            run.send_signal(signal.SIGINT)
        if not state.exists():
            raise click.ClickException(f"{step.name}: was done before it was interrupted")

    def write_depth_folder(self, recording: str) -> None:
        """Write the depth of a made recording as a folder of images, which no command does."""
        from posetrack_cli.recording.opening import open_recording

        folder = self._folder / "depth"
        folder.mkdir()
        opened = open_recording(self._folder / recording)
        for frame in opened.frames():
            cv2.imwrite(str(folder / f"{frame.index:06d}.png"), np.round(frame.depth).astype(np.uint16))
        camera = opened.cameras[0]
        values = {key: getattr(camera, key) for key in ("fx", "fy", "cx", "cy")}
        (folder / "camera.toml").write_text("".join(f"{key} = {value!r}\n" for key, value in values.items()))

    def copy_images(self, source: str, target: str) -> None:
        """Copy the images of a folder without what else is told of them."""
        (self._folder / target).mkdir()
        for path in sorted((self._folder / source).glob("*.png")):
            shutil.copy(path, self._folder / target / path.name)


def files_of(path: Path) -> list[Path]:
    """Return a file, or all files of a folder in order."""
    return sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]


def digest_of(content: bytes) -> str:
    """Return the SHA-256 of bytes."""
    return hashlib.sha256(content).hexdigest()


def differences(
    before: Mapping[str, Mapping[str, str]], now: Mapping[str, Mapping[str, str]]
) -> Iterator[str]:
    """Yield one line for each output that is not as it was."""
    for step, digests in now.items():
        known = before.get(step, {})
        for name in digests.keys() | known.keys():
            if digests.get(name) != known.get(name):
                was, is_now = (d.get(name, "nothing")[:16] for d in (known, digests))
                yield f"{step}: {name}: {was} before, {is_now} now"


@click.command()
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Write the digests here, JSON.")
@click.option(
    "--against", type=click.Path(path_type=Path, exists=True), help="Compare with digests of before."
)
@click.option("--only", type=click.Choice(list(GROUPS)), multiple=True, help="Only this and what it needs.")
@click.option("--keep", type=click.Path(path_type=Path), help="Work in this new folder and leave it.")
def main(output: Path | None, against: Path | None, only: Sequence[str], keep: Path | None) -> None:
    """Digest what every command writes; exit code 1 if anything differs from before."""
    os.environ["COLUMNS"] = "100"
    groups = [name for name in GROUPS if not only or name in only or name == "recordings"]
    began, now = time.monotonic(), dict[str, Mapping[str, str]]()
    with tempfile.TemporaryDirectory() as temporary:
        folder = keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=keep is None)
        workplace = Workplace(folder)
        for step in (step for name in groups for step in GROUPS[name]()):
            if step.name == "convert-folder":
                workplace.write_depth_folder("hand-C.mcap")
                workplace.copy_images("faces/left", "uncalibrated")
            now[step.name] = workplace.digest(step)
            print(f"{time.monotonic() - began:7.1f} s  {step.name}", file=sys.stderr, flush=True)
    print(f"{sum(len(d) for d in now.values())} digests of {len(now)} commands")
    if output is not None:
        output.write_text(json.dumps(now, indent=1) + "\n")
    if against is not None:
        lines = list(differences(json.loads(against.read_text()), now))
        print("\n".join(lines or ["nothing differs"]))
        sys.exit(1 if lines else 0)


if __name__ == "__main__":
    main(prog_name="scripts/digests")
