"""Steps: every command with every option that affects its output."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from digesting import inputs
from digesting.inputs import DEPTH_TOPIC, GREY_TOPIC, INFO_TOPIC, TENTHS_MISSING

_NAMED = re.compile(r"\{([^:}]+)(?::(\d))?\}")


@dataclass(frozen=True)
class Step:
    """A command line, or a function that writes inputs."""

    name: str  # unique
    # arguments of ``posetrack``; ``{name}`` stands for the first output of the step of that name,
    # ``{name:1}`` for the second
    arguments: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()  # written files or folders; empty if only standard output is digested
    # dependencies in addition to those in ``arguments``
    needed: tuple[str, ...] = ()
    printed: bool = False  # whether to digest standard output
    interrupted: bool = False  # whether to stop it with Ctrl-C after the first checkpoint and resume it
    make: Callable[[Path], object] | None = None  # writes inputs into a folder, instead of arguments

    @property
    def needs(self) -> tuple[str, ...]:
        """Names of all steps that must run first."""
        return (*self.needed, *(name for text in self.arguments for name, _ in _NAMED.findall(text)))

    def filled(self, outputs: Mapping[str, Sequence[str]]) -> list[str]:
        """Return the arguments with placeholders replaced by outputs."""
        return [_NAMED.sub(lambda m: outputs[m[1]][int(m[2] or 0)], text) for text in self.arguments]


def command(name: str, line: str, *outputs: str, printed: bool = False, interrupted: bool = False) -> Step:
    """Return the step of a command line; its outputs are the path after ``-o`` and ``outputs``."""
    arguments = tuple(shlex.split(line))
    written = [arguments[arguments.index("-o") + 1]] if "-o" in arguments else []
    shown = tuple(path for path in (*written, *outputs) if path != "-")
    return Step(name, arguments, shown, printed=printed, interrupted=interrupted)


def made(name: str, make: Callable[[Path], object], outputs: str, needed: str = "") -> Step:
    """Return a step that writes inputs by a function; names are separated by spaces."""
    return Step(name, outputs=tuple(outputs.split()), needed=tuple(needed.split()), make=make)


FEW = "--particles 64"
FEWER = "--particles 200"
# Options of ``hand run`` that skip the detection before the first frame
GIVEN = "--hand-side right --shape average --init {hand-C}"
FLUSH = "--set output.flush_frames=3"
OF_BAG = f"--topic {DEPTH_TOPIC} --camera-topic {INFO_TOPIC}"
OF_TENTHS = f"--depth-unit-mm .1 --missing {TENTHS_MISSING} --camera {{tenths:1}} --fps 30"


def recordings() -> Iterator[Step]:
    """Yield steps that generate recordings and other inputs."""
    hand, head = "hand synth --seed 3 --frames", "head synth --seed 4 --frames"
    fingers = "--finger-lengths 1.02 1 1 1 .98 --finger-widths 1 1 1.05 1 1 --thumb-place 1.1"
    palm = "--palm-width 1.03 --palm-length .97 --palm-thickness 1.05 --wrist-width 1.05"
    shape = f"{fingers} {palm} --padding-mm 1 --scale 1.03"
    switches = "--noise --edges --background --body --forearm --drops --late"
    without = switches.replace("--", "--no-")
    yield command("hand-C", f"{hand} 16 --motion C -o hand-C.mcap")
    yield command("hand-A", f"{hand} 12 --motion A --speed 1.2 {shape} --sensor d435 -o hand-A.mcap")
    yield command("hand-B", f"{hand} 16 --motion B --random-hand {switches} -o hand-B.mcap")
    yield command("near", f"{hand} 12 --hand-side left {without} --overwrite -o near.mcap")
    yield command("slow", f"{hand} 24 --fps 10 --speed .3 -o slow.mcap")
    yield made("mesh", inputs.write_mesh, "hand.glb")
    yield command("hand-mesh", f"{hand} 6 --hand-mesh {{mesh}} -o hand-mesh.mcap")

    seen = "--lens-distortion --drops --occlusion --light sudden --noise-factor .5 --distance-mm 650"
    small = "--image-format png --image-size 512x384 --baseline-mm 100 --no-expressions"
    slow = "--fps 10 --speed .3 --camera-count 1 --motion slight"
    yield command("two", f"{head} 16 --identity 2 -o two.mcap")
    yield command("one", f"{head} 16 --camera-count 1 {seen} --motion turn --speed 1.2 -o one.mcap")
    yield command("faces", f"{head} 8 --fps 25 {small} --overwrite -o faces")
    yield command("motions", f"{head} 16 --script two-motions --image-format raw -o motions.mcap")
    yield command("slow-head", f"{head} 24 {slow} -o slow-head.mcap")

    yield made("depth", inputs.write_depth_folder, "depth", "hand-C")
    yield made("tenths", inputs.write_tenths_folder, "tenths tenths.toml", "near")
    yield made("uncalibrated", inputs.copy_images, "uncalibrated", "faces")
    yield made("video", inputs.write_video, "face.mp4", "one")
    yield made("bags", inputs.write_bags, "depth.bag grey.bag", "hand-C two")
    yield made("ros2", inputs.write_ros2_folder, "ros2", "hand-C")
    yield made("kinect", inputs.write_kinect_file, "kinect.mkv")
    yield made("keypoints", inputs.write_keypoints, "keypoints.json joints.csv", "hand-C")
    yield made("landmarks", inputs.write_landmarks, "landmarks.csv clicked.csv", "two")
    yield from _later_inputs()
    yield made("people", inputs.write_people, "person-0.mcap person-1.mcap person-2.mcap")
    yield made("boards", inputs.write_boards, "chessboard charuco")
    yield made("lists", inputs.write_lists, "manifest.toml list.txt gates.txt", "hand-C near keypoints two")


def _later_inputs() -> Iterator[Step]:
    turned = "--seed 4 --frames 4 --camera-count 1 --yaw-range 40 --roll 15"
    yield command("turned", f"head synth {turned} -o turned.mcap")
    yield made("pair", inputs.write_pair_folder, "pair", "hand-C")
    yield made("face-truth", inputs.write_face_truth, "face-truth.csv", "one")


def conversions() -> Iterator[Step]:
    """Yield conversions of every format of depth and images."""
    converted = {
        "mcap": "{hand-C} --overwrite",
        "truth": "{depth} --fps 30 --truth {keypoints:1}",
        "tenths": f"{{tenths}} {OF_TENTHS}",
        "bag": f"{{bags}} {OF_BAG}",
        "ros2": "{ros2} --mirror",
        "kinect": "{kinect}",
        "raw": "{hand-C} --raw",
        "two": "{two} --cameras right,left --tolerance-ms 5",
        "faces": "{faces}",
        "video": "{video}",
        "colour": "{bags:1} --images",
    }
    for name, line in converted.items():
        yield command(f"convert-{name}", f"convert {line} -o converted-{name}.mcap")


def hand_runs() -> Iterator[Step]:
    """Yield runs of every hand tracker, and hand calibrations."""
    runs = {
        "rbpf": "{hand-C}",
        "smooth": f"{{hand-C}} --smooth {FEW}",
        "left": f"{{near}} {FEW} --overwrite",
        "own-shape": f"{{hand-B}} {FEW} --end 8",
        "pf": f"{{hand-C}} --filter pf {FEW} --end 8 {GIVEN}",
        "pf-smooth": f"{{hand-A}} --filter pf --smooth {FEW} --end 8",
        "pso": f"{{hand-C}} --filter pso --particles 16 --end 6 {GIVEN}",
        "fast": f"{{hand-C}} --config hand-fast --end 8 {GIVEN}",
        "paper": f"{{hand-A}} --config hand-paper {FEW} --init center --end 8",
        "marginal": f"{{hand-A}} --proposal marginal {FEW} --end 8",
        "multinomial": f"{{hand-C}} --resampling multinomial --cost paper {FEW} --end 8 {GIVEN}",
        "residual": f"{{hand-C}} --resampling residual --cost union --device cpu {FEW} --end 8 {GIVEN}",
        "stratified": f"{{hand-C}} --resampling stratified --set observation.sigma_mm=7 {FEW} {GIVEN}",
        "folder": f"{{depth}} --fps 30 --hand-side right --scale 1.02 --stride 2 --seed 7 {FEW}",
        "folder-tenths": f"{{tenths}} {OF_TENTHS} --end 6 {FEW}",
        "mirror": f"{{near}} --mirror --init center --end 8 {FEW}",
        "started": f"{{hand-C}} --init {{rbpf}} --start 5 --end 12 {FEW}",
        "keypoints-mm": f"{{hand-C}} --keypoints {{keypoints:1}} --keypoints-unit mm --end 8 {FEW}",
        "keypoints-px": f"{{hand-C}} --keypoints {{keypoints}} --keypoints-swap-sides --end 8 {FEW}",
        "mesh-run": f"{{hand-mesh}} --hand-mesh {{mesh}} {FEW}",
        "bag-run": f"{{bags}} {OF_BAG} --end 8 {FEW}",
        "ros2-run": f"{{ros2}} --end 8 --stride 2 {FEW}",
        "kinect-run": f"{{kinect}} --hand-side right {FEW}",
        "pair-run": f"{{pair}} --fps 30 --hands 2 --shape average --smooth --end 8 {FEW}",
    }
    for name, line in runs.items():
        yield command(name, f"hand run {line} -o {name}.mcap")
    for name in ("rbpf", "smooth"):
        line = f"hand run {runs[name]} -o {name}-resumed.mcap {FLUSH}"
        yield command(f"{name}-resumed", line, interrupted=True)
    calibrations = {
        "shape": "{hand-B} --fit-frames 8 --config hand-fast --overwrite",
        "shape-bag": f"{{bags}} {OF_BAG} --fit-frames 4 --hand-side right",
        "shape-tenths": f"{{tenths}} {OF_TENTHS} --fit-frames 4 --mirror",
        "shape-mesh": "{hand-mesh} --hand-mesh {mesh} --fit-frames 4",
    }
    for name, line in calibrations.items():
        yield command(name, f"hand calibrate {line} -o {name}.toml")
    yield command("shaped", f"hand run {{hand-B}} --shape {{shape}} --end 8 {FEW} -o shaped.mcap")


def head_runs() -> Iterator[Step]:
    """Yield runs of both head trackers, and a face model."""
    people = "{people} {people:1} {people:2} --identity-size 2 --deformation-size 3"
    picture = "--picture face.png --overwrite"
    yield command("face", f"head build-model {people} {picture} -o face.npz", "face.png")
    stereo = {
        "stereo": f"{{two}} --smooth --overwrite --save-model stereo.npz {FEWER}",
        "stereo-default": "{two} --end 8",
        "stereo-two": f"{{two}} --passes 2 --end 10 {FEWER}",
        "stereo-rigid": f"{{two}} --model rigid --seed 3 --cameras right,left --tolerance-ms 5 {FEWER}",
        "stereo-folder": f"{{faces}} --fps 30 --stride 2 {FEWER}",
        "stereo-mirror": f"{{faces}} --camera faces/camera.toml --mirror --end 6 {FEWER}",
        "stereo-loaded": f"{{two}} --load-model {{stereo:1}} --start 4 {FEWER}",
        "stereo-paper": f"{{two}} --config head-stereo-paper --end 8 {FEWER}",
        "stereo-landmarks": f"{{two}} --landmarks {{landmarks}} --landmarks-unit px --end 8 {FEWER}",
        "stereo-clicked": f"{{two}} --init {{landmarks:1}} --detector haar --end 8 {FEWER}",
        "stereo-faces": f"{{two}} --faces all --passes 2 --end 10 {FEWER}",
        "motions-result": f"{{motions}} --set model.components=3 {FEWER}",
    }
    mono = {
        "mono": f"{{one}} --overwrite --save-model mono.npz {FEWER}",
        "mono-default": "{two} --cameras left --end 8",
        "mono-smooth": f"{{two}} --cameras left --smooth --passes 1 {FEWER}",
        "mono-start": f"{{two}} --cameras left --adjust start --end 8 {FEWER}",
        "mono-never": f"{{one}} --adjust never --passes 1 --start 2 --stride 2 {FEWER}",
        "mono-loaded": f"{{one}} --load-model {{mono:1}} --passes 1 {FEWER}",
        "mono-guess": f"{{uncalibrated}} --fov 50 --fps 30 --interpupillary-mm 62 --passes 1 {FEWER}",
        "mono-person": f"{{two}} --cameras left --person {{stereo}} --end 8 --passes 1 {FEWER}",
        "mono-model": f"{{two}} --cameras left --face-model {{face}} --end 8 --passes 1 {FEWER}",
        "mono-landmarks": f"{{two}} --cameras left --landmarks {{landmarks}} --landmarks-unit px --end 8 "
        f"--passes 1 {FEWER}",
        "mono-clicked": f"{{two}} --cameras left --init {{landmarks:1}} --end 8 --passes 1 {FEWER}",
        "mono-video": f"{{video}} --face 1 --detector haar --seed 5 --passes 1 {FEWER}",
        "mono-mirror": f"{{faces}} --cameras left --camera faces/camera.toml --mirror --passes 1 {FEWER}",
        "mono-bag": f"{{bags:1}} --cameras {GREY_TOPIC} --end 8 --passes 1 {FEWER}",
        "mono-paper": f"{{two}} --cameras left --config head-mono-paper --end 8 --passes 1 {FEWER}",
        "mono-faces": f"{{one}} --faces all --end 10 {FEWER}",
        "mono-set": f"{{two}} --cameras left --set adjustment.views=4 --end 8 --passes 1 {FEWER}",
    }
    saved = {"stereo": ("stereo.npz",), "mono": ("mono.npz",)}
    for kind, runs in (("stereo", stereo), ("mono", mono)):
        for name, line in runs.items():
            yield command(name, f"head {kind} {line} -o {name}.mcap", *saved.get(name, ()))
    for kind, name, line in (
        ("stereo", "stereo-two", stereo["stereo-two"]),
        ("mono", "mono-smooth", mono["mono-smooth"]),
    ):
        again = f"head {kind} {line} -o {name}-resumed.mcap {FLUSH}"
        yield command(f"{name}-resumed", again, interrupted=True)


def exports() -> Iterator[Step]:
    """Yield runs of ``info`` and ``export``."""
    for name in ("hand-C", "one", "depth", "faces", "video", "bags", "ros2", "kinect", "smooth", "mono"):
        yield command(f"info-{name}", f"info {{{name}}} --json -", printed=True)
        yield command(f"info-text-{name}", f"info {{{name}}}", printed=True)
    yield command("info-file", "info {hand-C} --overwrite --json info.json", "info.json")
    for name, kinds in {
        "smooth": "csv tum json npz bvh c3d mcap",
        "stereo": "csv tum json npz c3d mcap",
        "mono": "csv tum npz",
        "pso": "json",
    }.items():
        for kind in kinds.split():
            yield command(f"export-{name}-{kind}", f"export {{{name}}} -o exported-{name}.{kind}")
    yield command("export-pair", "export {pair-run} --of left -o exported-left.csv")
    yield command("export-smoothed", "export {smooth} --track smoothed --no-lost -o exported-smoothed.csv")
    yield command("export-protobuf", "export {smooth} --schemas protobuf -o exported-protobuf.mcap")
    ros2 = "--format mcap --schemas ros2 --estimate-topic /truth/hand/estimate --overwrite"
    yield command("export-truth", f"export {{smooth}} {ros2} -o exported-truth.mcap")
    yield command("export-printed", "export {stereo} --format tum", printed=True)
    for name, kind, suffix in (
        *(("smooth", "rom", "csv"), ("smooth", "mediapipe", "json")),
        *(("stereo", "rom", "csv"), ("stereo", "openface", "csv")),
    ):
        yield command(
            f"export-{name}-{kind}", f"export {{{name}}} --format {kind} -o exported-{name}-{kind}.{suffix}"
        )
    motion = "study/sub-01/motion/sub-01_task-reach_tracksys-hand_motion.tsv"
    yield command("export-bids", f"export {{smooth}} --session-start 2026-01-31T10:00:00Z -o {motion}")


def reports() -> Iterator[Step]:
    """Yield runs of ``eval``."""
    suffixes = {"html": "html", "json": "json", "csv": "csv", "junit": "xml", "markdown": "md"}
    gates = "--fail-if joint_error_mm.mean>1"
    of_heads = "--fail-if point_error_mm.mean>5"
    measured = {
        "rbpf": f"{{rbpf}} --truth {{hand-C}} --recording {{hand-C}} --overwrite --honesty {gates}",
        "smooth": f"{{smooth}} --truth {{hand-C}} --track both --joint-offsets palm --parts --columns "
        f"{gates}",
        "left": f"{{left}} --truth {{near}} --align rigid --time-offset-s .001 --truth-tolerance-ms 8 "
        f"{gates}",
        "joints": f"{{started}} --truth {{keypoints:1}} {gates}",
        "stereo": f"{{stereo}} --truth {{two}} --align rigid+points --parts --track smoothed {of_heads}",
        "mono": "{mono} --truth {one} --align similarity --face-truth {face-truth} --gates {lists:2}",
        "pair": "{pair-run} --of left",
        "compared": f"{{rbpf}} {{pf}} {{fast}} --truth {{hand-C}} {gates}",
        "groups": f"{{rbpf}} {{pf}} {{fast}} {{own-shape}} --group a=rbpf.mcap --group b=pf.mcap {gates}",
        "rows": "{rbpf} {pf} {fast} {smooth} {left} --rows --worst 3 --honesty --baseline {eval-rbpf} "
        "--baseline-tolerance .5",
    }
    for name, line in measured.items():
        written = {kind: f"{name}.eval.{suffix}" for kind, suffix in suffixes.items()}
        if name in ("rbpf", "smooth", "stereo", "mono"):
            written["mcap"] = f"{name}.eval.mcap"
        if name in ("rbpf", "compared"):
            written["curve"] = f"{name}.curve.csv"
        options = " ".join(f"--{kind} {path}" for kind, path in written.items())
        json_first = sorted(written.values(), key=lambda path: not path.endswith(".json"))
        yield command(f"eval-{name}", f"eval {line} {options}", *json_first, printed=True)
    yield command("eval-metrics", "eval --list-metrics", printed=True)


def pictures() -> Iterator[Step]:
    """Yield runs of ``view``: folders, contact sheets and videos."""
    of_folder = "--any-recording --depth-unit-mm .1 --missing 65535 --fps 30 --camera {tenths:1} --no-mirror"
    drawn = {
        "rbpf": "{rbpf} --recording {hand-C} --show-truth --skeleton --select 3,10 --overwrite -o view-rbpf",
        "smooth": "{smooth} --recording {hand-C} --track both --layout over --select 3,10 -o view-smooth",
        "stereo": "{stereo} --recording {two} --show-truth --select 3,10 -o view-stereo",
        "mono": "{mono} --recording {one} --crop head --zoom 2 --select 3,10 -o view-mono",
        "segments": "{rbpf} --layout segments --select spread:4 --device cpu -o view-segments.png",
        "paper": "{rbpf} --layout paper --select worst:2 --range-mm 500 900 -o view-paper.png",
        "compared": "{rbpf} {fast} --recording {hand-C} --rate 10 --select 0:6 -o view-compared.mp4",
        "messages": "{smooth} --recording {hand-C} -o view-smooth.mcap",
        "images": "{stereo} --recording {two} -o view-stereo.mcap",
        "bag": f"{{bag-run}} --recording {{bags}} {OF_BAG} --select 2,4 -o view-bag",
        "pair": "{pair-run} --recording {pair} --fps 30 --of left --select 2 -o view-pair",
        "tenths": f"{{folder-tenths}} --recording {{tenths}} {of_folder} --select 2 -o view-tenths",
    }
    for name, line in drawn.items():
        yield command(f"view-{name}", f"view {line}")


def calibrations() -> Iterator[Step]:
    """Yield camera calibrations."""
    charuco = "--squares 7x5 --square-mm 26 --marker-mm 19 --dictionary 4X4_50 --distortion five"
    boards = {
        "chessboard": "{boards} --squares 8x6 --square-mm 22 --overwrite",
        "charuco": f"{{boards:1}} {charuco} --cameras right,left",
    }
    for name, line in boards.items():
        yield command(f"rig-{name}", f"calibrate stereo {line} -o rig-{name}.toml")


def batches() -> Iterator[Step]:
    """Yield batches: several recordings, one recording, chunks of a long one."""
    gates = "--fail-if coverage<.5 --gates {lists:2} --baseline {eval-rbpf} --baseline-tolerance .5"
    reported = "--junit batch.xml --markdown batch.md"
    bounds = "--timeout 600 --memory-limit 8G --jobs 1"
    yield command(
        "batch-hand",
        f"batch hand run {{lists}} --smooth {gates} {reported} {bounds} -o batch-hand",
        "batch.xml",
        "batch.md",
    )
    again = "batch hand run {lists} --smooth --jobs 1 --dry-run"
    yield command("batch-dry", f"{again} --output batch-hand", printed=True)
    pieces = "--chunk-s 1 --overlap-s .4 --jobs 1 --redo --no-reports --smooth"
    yield command("batch-pieces", f"batch hand run {{slow}} {pieces} {FEW} -o batch-pieces")
    yield command("batch-stereo", f"batch head stereo {{lists:1}} --end 8 --jobs 1 {FEWER} -o batch-stereo")
    pieces = f"{pieces} --passes 1"
    yield command("batch-mono", f"batch head mono {{slow-head}} {pieces} {FEWER} -o batch-mono")


def groups() -> Mapping[str, Sequence[Step]]:
    """Return all steps by group, in execution order."""
    made_by: Mapping[str, Callable[[], Iterator[Step]]] = {
        "recordings": recordings,
        "conversions": conversions,
        "hand": hand_runs,
        "head": head_runs,
        "exports": exports,
        "reports": reports,
        "pictures": pictures,
        "calibrations": calibrations,
        "batches": batches,
    }
    return {name: tuple(make()) for name, make in made_by.items()}
