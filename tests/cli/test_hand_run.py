"""``posetrack hand run`` end to end, on small recordings."""

from __future__ import annotations

import filecmp
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from numba.core.event import trigger_event

from posetrack_cli.cli.main import run
from posetrack_cli.cli.running import progress
from posetrack_cli.errors import EXIT_DATA_LOST
from posetrack_cli.evaluation.measuring.evaluate import evaluate
from posetrack_cli.evaluation.measuring.evaluation import Statistics
from posetrack_cli.hand.tracker import HandTracker
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.outputs import part_path, state_path
from posetrack_cli.recording.message_cameras import calibration_message
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results import load_arrays, read_result
from support.terminal import Terminal

FRAMES = 24
SMALL = ["--particles", "48"]
FLUSHED = 2
FLUSHING = ["--particles", "256", "--end", "8", "--set", f"output.flush_frames={FLUSHED}"]
"""Slow enough to be stopped in the middle."""
RIGHT = ["--hand-side", "right"]
Track = Callable[..., int]
FOUND_MM = 20.0
"""Mean error of the joints of a hand that is found: half a finger's width off at most."""
COMMAND = [sys.executable, "-m", "posetrack_cli.cli.main"]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("synth") / "hand.mcap"
    arguments = [
        "hand",
        "synth",
        "--motion",
        "C",
        "--frames",
        str(FRAMES),
        "--seed",
        "3",
        "--no-drops",
        "-o",
        str(path),
    ]
    assert run(arguments) == 0
    return path


@pytest.fixture(scope="module")
def folder(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same recording as a folder of images."""
    path = tmp_path_factory.mktemp("folder")
    write_folder(path, [(frame.stamp_ns, frame.depth.astype(np.uint16)) for frame in read_frames(recording)])
    camera = open_recording(recording).cameras[0]
    (path / "camera.toml").write_text(
        f"fx = {camera.fx}\nfy = {camera.fy}\ncx = {camera.cx}\ncy = {camera.cy}\n"
    )
    return path


@pytest.fixture(scope="module")
def told(recording: Path) -> list[str]:
    """The true side, shape and first pose: to search a whole image for them takes longer than some frames."""
    return [*RIGHT, "--shape", "average", "--init", str(recording)]


@pytest.fixture(scope="module")
def track(told: list[str]) -> Track:
    """A run in this process, from the true start."""

    def tracked(source: Path, output: Path, *options: str) -> int:
        return run(["hand", "run", str(source), "-o", str(output), *told, *SMALL, *options])

    return tracked


@pytest.fixture(scope="module")
def result(recording: Path, track: Track, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("result") / "result.mcap"
    assert track(recording, path) == 0
    return path


def read_frames(path: Path):
    return list(open_recording(path).frames())


def write_folder(path: Path, images: list[tuple[int, np.ndarray]], camera: bool = True) -> None:
    names = [f"{index:06d}.png" for index in range(len(images))]
    for name, (_, image) in zip(names, images, strict=True):
        assert cv2.imwrite(str(path / name), image)
    rows = [f"{name},{stamp}" for name, (stamp, _) in zip(names, images, strict=True)]
    (path / "timestamps.csv").write_text("\n".join(["filename,stamp_ns", *rows]) + "\n")
    if camera:
        (path / "camera.toml").write_text("fx = 365.0\nfy = 365.0\ncx = 256.0\ncy = 212.0\n")


def error_lines(capsys: pytest.CaptureFixture[str]) -> list[str]:
    """The lines on standard error, without those of a machine's first run."""
    said = [line for line in capsys.readouterr().err.splitlines() if line.strip()]
    return [line for line in said if not line.startswith("compiling kernels")]


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    """The one line on standard error."""
    (line,) = error_lines(capsys)
    return line


def same_estimates(first: Path, second: Path, count: int | None = None) -> None:
    """All estimates are the same, or so many at the beginning."""
    a, b = load_arrays(first), load_arrays(second)
    for name in a:
        np.testing.assert_array_equal(a[name][:count], b[name][:count], err_msg=name)


def test_result_holds_every_frame_with_truth_and_run_record(recording: Path, result: Path) -> None:
    opened, arrays = read_result(result), load_arrays(result)
    assert opened.finished and not opened.truncated
    assert arrays["stamp_ns"].tolist() == [frame.stamp_ns for frame in read_frames(recording)]
    assert opened.run["seed"] == "0" and opened.run["renderer"]
    assert opened.summary["frames"] == str(FRAMES)
    truth = load_arrays(result, "/truth/hand/estimate")
    assert truth["stamp_ns"].tolist() == arrays["stamp_ns"].tolist()


def test_a_run_that_is_told_nothing_finds_what_one_is_told(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The side, and in its first frame the hand, which the hand's true size does not change."""
    given = {"nothing": [], "side and shape": [*RIGHT, "--shape", "average"]}
    for name, options in given.items():
        output = str(tmp_path / f"{name}.mcap")
        assert run(["hand", "run", str(recording), "-o", output, *SMALL, "--end", "2", *options]) == 0
    assert "hand.mcap: a right hand" in capsys.readouterr().err
    nothing, told = (load_arrays(tmp_path / f"{name}.mcap") for name in given)
    np.testing.assert_array_equal(nothing["points"], told["points"])
    truth = load_arrays(tmp_path / "nothing.mcap", "/truth/hand/estimate")["points"][:2]
    assert np.linalg.norm(nothing["points"] - truth, axis=2).mean() < FOUND_MM


def test_a_run_that_compiles_says_once_why_it_waits(
    track: Track,
    recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Here every frame compiles. That real kernels are kept, with equal bytes, ``doctor --warm`` checks."""
    step = HandTracker.step

    def compiling(*arguments: Any) -> Any:
        with trigger_event("numba:compile"):
            return step(*arguments)

    monkeypatch.setattr(HandTracker, "step", compiling)
    assert track(recording, tmp_path / "r.mcap", "--end", "3") == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "compiling" in line]
    assert said == ["compiling kernels: about 30 s of CPU time, cached for later runs ..."]


def test_tracks_the_hand(recording: Path, told: list[str], tmp_path: Path) -> None:
    """From the true start, 512 particles stay near: hand.md gives about 20 mm for plain sampling; twice that
    leaves room for the seed and still is far below what a hand that does not move would get wrong."""
    output = tmp_path / "r.mcap"
    assert run(["hand", "run", str(recording), "-o", str(output), *told]) == 0
    measured = evaluate(output)
    errors = measured.metrics["joint_error_mm"]
    assert measured.coverage.share == 1.0
    assert isinstance(errors, Statistics) and errors.mean < 40.0


def test_another_seed_gives_other_estimates(
    track: Track, recording: Path, result: Path, tmp_path: Path
) -> None:
    """That two runs of the same give the same bytes, those that were stopped and resumed show."""
    assert track(recording, tmp_path / "b.mcap", "--seed", "1", "--end", "4") == 0
    other, one = (load_arrays(path)["position"] for path in (tmp_path / "b.mcap", result))
    assert not np.array_equal(other, one[:4])


def test_a_recording_its_folder_and_what_that_is_converted_to_give_identical_estimates(
    track: Track, folder: Path, result: Path, tmp_path: Path
) -> None:
    assert run(["convert", str(folder), "-o", str(tmp_path / "in.mcap")]) == 0
    assert track(folder, tmp_path / "a.mcap", "--end", "6") == 0
    assert track(tmp_path / "in.mcap", tmp_path / "b.mcap", "--end", "6") == 0
    same_estimates(tmp_path / "a.mcap", tmp_path / "b.mcap")
    same_estimates(tmp_path / "a.mcap", result, 5)  # the last one's velocity does not know the next frame


@pytest.mark.parametrize(
    "options",
    [
        ["--filter", "pf"],
        ["--filter", "pf", "--set", "velocity.method=filter"],
        ["--proposal", "paper"],
        ["--cost", "paper"],
        ["--config", "hand-paper"],
        *(["--resampling", name] for name in ("multinomial", "residual", "stratified")),
    ],
    ids=" ".join,
)
def test_every_variant_runs(track: Track, recording: Path, tmp_path: Path, options: list[str]) -> None:
    tracked = track(recording, tmp_path / "r.mcap", "--end", "4", *options)
    assert tracked == (EXIT_DATA_LOST if "paper" in options and "--proposal" in options else 0)
    arrays = load_arrays(tmp_path / "r.mcap")
    assert len(arrays["stamp_ns"]) == 4
    assert ("velocity.method=filter" in options) == (not arrays["twist"].any())


def test_start_end_stride_choose_frames(track: Track, recording: Path, tmp_path: Path) -> None:
    assert track(recording, tmp_path / "r.mcap", "--start", "3", "--end", "12", "--stride", "4") == 0
    assert load_arrays(tmp_path / "r.mcap")["frame_index"].tolist() == [3, 7, 11]


def test_timings_are_written_only_when_asked_for(
    track: Track, recording: Path, result: Path, tmp_path: Path
) -> None:
    assert track(recording, tmp_path / "r.mcap", "--end", "3", "--timings") == 0
    assert (load_arrays(tmp_path / "r.mcap")["milliseconds"] > 0).all()
    assert np.isnan(load_arrays(result)["milliseconds"]).all()


def test_closing_line(
    track: Track, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert track(recording, tmp_path / "r.mcap", "--end", "3") == 0
    closing, report, video = capsys.readouterr().out.splitlines()
    rates = r"\((\S+) frames/s; tracking alone (\S+) frames/s\)"
    told = re.fullmatch(rf"3 frames in \d+\.\d s {rates}, 0 lost.*: .*r\.mcap", closing)
    assert told is not None, closing
    whole, alone = map(float, told.groups())
    assert 0.0 < whole <= alone
    assert report.startswith("next: posetrack eval ") and video.startswith("next: posetrack view ")


# Killed and interrupted runs


def start_flushing(recording: Path, output: Path, told: list[str]) -> subprocess.Popen[str]:
    """A run in a process of its own."""
    arguments = [*COMMAND, "hand", "run", str(recording), "-o", str(output), *FLUSHING, *told]
    return subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for_flush(process: subprocess.Popen[str], output: Path) -> None:
    """Wait until the first frames are flushed: the checkpoint then holds a tracker's state."""
    deadline = time.monotonic() + 120.0
    while time.monotonic() < deadline and process.poll() is None:
        if state_path(output).exists():
            with np.load(state_path(output)) as saved:
                if "array.pose" in saved.files:
                    return
        time.sleep(0.01)
    raise AssertionError(f"nothing was flushed: {process.communicate()}")


@pytest.fixture(scope="module")
def flushed_result(recording: Path, told: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("flushed") / "r.mcap"
    assert run(["hand", "run", str(recording), "-o", str(path), *FLUSHING, *told]) == 0
    return path


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_stopped_run_is_readable_and_resumes_to_the_same_bytes(
    recording: Path, told: list[str], flushed_result: Path, tmp_path: Path, number: signal.Signals
) -> None:
    """That SIGINT ends a run as SIGTERM does ``test_interruption`` shows."""
    output = tmp_path / "r.mcap"
    process = start_flushing(recording, output, told)
    wait_for_flush(process, output)
    process.send_signal(number)
    _, errors = process.communicate()
    assert not output.exists() and part_path(output).exists()
    if number is signal.SIGKILL:
        assert process.returncode == -signal.SIGKILL
        assert run(["info", str(part_path(output))]) == 3
    else:
        assert process.returncode == 130
        assert "--resume" in errors.splitlines()[-1]
        assert run(["info", str(part_path(output))]) == 0
    assert len(list(read_result(part_path(output)).estimates())) >= FLUSHED
    assert run(["hand", "run", str(recording), "-o", str(output), *FLUSHING, *told, "--resume"]) == 0
    assert filecmp.cmp(output, flushed_result, shallow=False)
    assert not part_path(output).exists() and not state_path(output).exists()


@pytest.mark.parametrize("index", [5, 15])
def test_the_progress_bar_stands_at_the_frame(monkeypatch: pytest.MonkeyPatch, index: int) -> None:
    """Frames 5, 7, ... 23: a resumed run does not start from 0, and its rate is that of its own frames."""
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    estimate = SimpleNamespace(frame_index=index, effective_sample_size=7.4, status="lost")
    with progress(10, 5, 2, "hand") as report:
        report(estimate)
    (shown,) = terminal.lines
    assert f" {(index - 5) // 2 + 1}/10 [" in shown and shown.endswith("ESS 7 lost]")


def test_resume_of_nothing_says_so(
    track: Track, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert track(recording, tmp_path / "r.mcap", "--resume") == 1
    assert "r.mcap.part" in one_line(capsys)


# Bad input: one line, the right exit code, nothing lost


def test_missing_path(track: Track, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert track(tmp_path / "nothing", tmp_path / "r.mcap") == 1
    assert "no such file or folder" in one_line(capsys)


def test_empty_folder(track: Track, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    assert track(tmp_path / "empty", tmp_path / "r.mcap") == 1
    assert "empty" in one_line(capsys)


def test_an_image_of_another_size_costs_a_frame(
    track: Track, tmp_path: Path, recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = [(frame.stamp_ns, frame.depth.astype(np.uint16)) for frame in read_frames(recording)[:5]]
    images[3] = (images[3][0], images[3][1][:400, :500])
    source = tmp_path / "mixed"
    source.mkdir()
    write_folder(source, images)
    assert track(source, tmp_path / "r.mcap") == 3
    line = one_line(capsys)
    assert "000003.png" in line and "size is 500x400, not 512x424 like the first: 1" in line
    assert load_arrays(tmp_path / "r.mcap")["frame_index"].tolist() == [0, 1, 2, 4]


def test_eight_bit_images(track: Track, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_folder(tmp_path, [(0, np.full((40, 50), 200, np.uint8))])
    assert track(tmp_path, tmp_path / "r.mcap") == 1
    assert "8" in one_line(capsys)


def test_no_intrinsics(track: Track, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_folder(tmp_path, [(0, np.full((40, 50), 700, np.uint16))], camera=False)
    assert track(tmp_path, tmp_path / "r.mcap") == 1
    assert "camera.toml" in one_line(capsys)


def test_wrong_topic_lists_candidates(
    track: Track, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert track(recording, tmp_path / "r.mcap", "--topic", "/camera/depht/image") == 1
    assert "/camera/depth/image" in one_line(capsys)


def test_truncated_recording_is_tracked_up_to_the_cut(
    track: Track, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.mcap"
    data = recording.read_bytes()
    cut.write_bytes(data[: len(data) * 2 // 3])
    readable = len(read_frames(cut))
    assert 0 < readable < FRAMES
    assert track(cut, tmp_path / "r.mcap") == 3
    assert "truncated" in one_line(capsys)
    assert len(load_arrays(tmp_path / "r.mcap")["stamp_ns"]) == readable


@pytest.mark.parametrize("stamps", [[0, 40, 30, 80], [0, 40, 40, 80]], ids=["backwards", "doubled"])
def test_stamps_that_do_not_increase_cost_a_frame(
    track: Track, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], stamps: list[int]
) -> None:
    depths = [frame.depth.astype(np.uint16) for frame in read_frames(recording)[:4]]
    write_folder(tmp_path, [(stamp * 10**6, depth) for stamp, depth in zip(stamps, depths, strict=True)])
    assert track(tmp_path, tmp_path / "r.mcap") == 3
    assert "frame 2" in one_line(capsys)
    assert load_arrays(tmp_path / "r.mcap")["frame_index"].tolist() == [0, 1, 3]


def test_frames_without_readings_are_lost_but_there(
    track: Track, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = read_frames(recording)[:4]
    images = [(frame.stamp_ns, frame.depth.astype(np.uint16)) for frame in frames]
    images[2] = (images[2][0], np.zeros_like(images[2][1]))
    write_folder(tmp_path, images)
    assert track(tmp_path, tmp_path / "r.mcap") == 3
    assert "frames without any reading: 1, first frame 2" in one_line(capsys)
    assert load_arrays(tmp_path / "r.mcap")["status"].tolist() == ["tracking", "tracking", "lost", "tracking"]


def test_nothing_but_zeros(track: Track, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_folder(tmp_path, [(k * 10**7, np.zeros((424, 512), np.uint16)) for k in range(3)])
    assert track(tmp_path, tmp_path / "r.mcap") == 3
    lost, seen = error_lines(capsys)
    assert "frames without any reading: 3" in lost
    assert "only 0 of 3 frames tracked: no reading in 3 sampled frames" in seen
    arrays = load_arrays(tmp_path / "r.mcap")
    assert set(arrays["status"]) == {"lost"} and not arrays["confidence"].any()


def test_a_frame_of_nan(
    track: Track, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

    opened = open_recording(recording)
    path = tmp_path / "nan.mcap"
    with McapSink(path) as sink:
        calibration, images = sink.channel("/c", CameraCalibration), sink.channel("/d", RawImage)
        message = calibration_message(opened.cameras[0], 0, "camera")
        sink.write(calibration, 0, message.SerializeToString())
        for number, frame in enumerate(read_frames(recording)[:4]):
            metres = (frame.depth / 1000.0).astype(np.float32)
            metres[:] = np.nan if number == 1 else metres
            height, width = metres.shape
            image = RawImage(
                width=width, height=height, encoding="32FC1", step=4 * width, data=metres.tobytes()
            )
            image.frame_id = "camera"
            image.timestamp.FromNanoseconds(frame.stamp_ns + 1)
            sink.write(images, frame.stamp_ns + 1, image.SerializeToString())
        sink.finish()
    assert track(path, tmp_path / "r.mcap") == 3
    assert "frames without any reading: 1, first frame 1" in one_line(capsys)
    arrays = load_arrays(tmp_path / "r.mcap")
    assert np.isfinite(arrays["position"]).all() and arrays["status"][1] == "lost"


def test_unwritable_output(
    track: Track, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert track(recording, tmp_path / "no" / "such" / "r.mcap") == 1
    assert "no folder" in one_line(capsys)


def test_existing_output_is_not_replaced(
    track: Track, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "r.mcap").write_text("precious")
    assert track(recording, tmp_path / "r.mcap") == 2
    assert "--overwrite" in one_line(capsys)
    assert (tmp_path / "r.mcap").read_text() == "precious"
    assert track(recording, tmp_path / "r.mcap", "--end", "2", "--overwrite") == 0


@pytest.mark.parametrize("name", ["hand.mcap", "./link.mcap"])
def test_the_recording_is_never_replaced(
    track: Track, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    source = tmp_path / "hand.mcap"
    source.write_bytes(recording.read_bytes())
    (tmp_path / "link.mcap").symlink_to(source)
    assert track(source, tmp_path / name, "--overwrite") == 2
    assert "would replace the recording" in one_line(capsys)
    assert filecmp.cmp(source, recording, shallow=False)
    assert not part_path(source).exists()


def test_full_disk_keeps_what_was_flushed(
    recording: Path, told: list[str], flushed_result: Path, tmp_path: Path
) -> None:
    output = tmp_path / "r.mcap"
    allowed = flushed_result.stat().st_size * 3 // 4

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (allowed, allowed))

    arguments = [*COMMAND, "hand", "run", str(recording), "-o", str(output), *FLUSHING, *told]
    done = subprocess.run(arguments, preexec_fn=limit, capture_output=True, text=True)
    assert done.returncode == 1, done.stderr
    assert "too large" in done.stderr.splitlines()[-1] and "Traceback" not in done.stderr
    kept = list(read_result(part_path(output)).estimates())
    assert len(kept) in range(FLUSHED, 8, FLUSHED)


def test_unknown_configuration_key_names_the_nearest(
    track: Track, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "c.toml").write_text("[filter]\nparticels = 10\n")
    assert track(recording, tmp_path / "r.mcap", "--config", str(tmp_path / "c.toml")) == 2
    line = one_line(capsys)
    assert "filter.particels" in line and "did you mean 'particles'?" in line


def test_no_particles(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["hand", "run", str(recording), "-o", str(tmp_path / "r.mcap"), "--particles", "0"]) == 2
    assert "0 is not in the range" in capsys.readouterr().err
    (tmp_path / "c.toml").write_text("[filter]\nparticles = 0\n")
    arguments = [
        "hand",
        "run",
        str(recording),
        "-o",
        str(tmp_path / "r.mcap"),
        "--config",
        str(tmp_path / "c.toml"),
    ]
    assert run(arguments) == 2
    assert "filter.particles" in one_line(capsys)


def test_without_opengl_hands_are_drawn_by_the_processor(
    recording: Path, told: list[str], tmp_path: Path
) -> None:
    environment = os.environ | {"__EGL_VENDOR_LIBRARY_FILENAMES": str(tmp_path / "none.json")}
    out = tmp_path / "r.mcap"
    arguments = [*COMMAND, "hand", "run", str(recording), "-o", str(out), *told, *SMALL, "--end", "2"]
    done = subprocess.run([*arguments, "--device", "0"], env=environment, capture_output=True, text=True)
    assert done.returncode == 1
    assert "libegl1" in done.stderr and len(done.stderr.splitlines()) == 1
    done = subprocess.run(arguments, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert str(read_result(out).run["renderer"]).startswith("processor (")
    asked = [*COMMAND, "doctor", "--particles", "16"]
    doctor = subprocess.run(asked, env=environment, capture_output=True, text=True)
    assert doctor.returncode == 1 and "libegl1" in doctor.stderr


def test_no_frame_in_the_range(
    track: Track, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for options in (["--start", "1000"], ["--start", "5", "--end", "5"]):
        assert track(recording, tmp_path / "r.mcap", *options) == 2
        line = one_line(capsys)
        assert f"found {FRAMES} frames" in line and "--start" in line
    assert not list(tmp_path.iterdir())  # nothing is left that a second try would have to overwrite


def test_an_interrupted_run_is_not_replaced(
    track: Track, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    part_path(tmp_path / "r.mcap").touch()
    state_path(tmp_path / "r.mcap").touch()
    assert track(recording, tmp_path / "r.mcap") == 2
    assert "--resume" in one_line(capsys)


def test_wrong_start_file(
    track: Track, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert track(recording, tmp_path / "r.mcap", "--init", str(tmp_path / "none.toml")) == 2
    assert "none.toml" in one_line(capsys)


def test_an_unfinished_result_can_be_started_from(
    track: Track, recording: Path, result: Path, tmp_path: Path
) -> None:
    unfinished = tmp_path / "before.mcap.part"
    unfinished.write_bytes(result.read_bytes()[: result.stat().st_size * 3 // 4])
    assert track(recording, tmp_path / "a.mcap", "--init", str(unfinished), "--end", "2") == 0
    assert track(recording, tmp_path / "b.mcap", "--init", str(result), "--end", "2") == 0
    same_estimates(tmp_path / "a.mcap", tmp_path / "b.mcap")


def test_real_kinect_frames_from_folder_and_mcap(track: Track, tmp_path: Path, measured_data: Path) -> None:
    """All 181 frames are compared in ``recording/test_conversion``; two of them are tracked here."""
    kinect = tmp_path / "kinect"
    kinect.mkdir()
    for image in sorted((measured_data / "kinect2-hand").glob("*.png"))[::100]:
        shutil.copy(image, kinect)
    camera = tmp_path / "camera.toml"
    camera.write_text("fx = 363.9\nfy = 363.9\ncx = 255.4\ncy = 206.3\n")
    reading = ["--fps", "30", "--camera", str(camera)]
    assert run(["convert", str(kinect), "-o", str(tmp_path / "in.mcap"), *reading]) == 0
    left = ["--hand-side", "left"]
    # with so few particles neither of two frames that are 100 apart is tracked
    assert track(kinect, tmp_path / "a.mcap", *left, *reading) == EXIT_DATA_LOST
    assert track(tmp_path / "in.mcap", tmp_path / "b.mcap", *left) == EXIT_DATA_LOST
    same_estimates(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert len(load_arrays(tmp_path / "a.mcap")["stamp_ns"]) == 2
