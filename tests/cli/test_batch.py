"""``posetrack batch`` end to end: on this machine, and on a real cluster in which things go wrong."""

from __future__ import annotations

import csv
import filecmp
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from posetrack_cli import build
from posetrack_cli.batch.execution import run_job
from posetrack_cli.batch.jobs import Job, Limits, Outcome, State
from posetrack_cli.build import PACKAGE, source_digest
from posetrack_cli.cli.batch import BATCH_OPTIONS
from posetrack_cli.cli.batch_commands import BATCH_COMMANDS
from posetrack_cli.cli.main import run
from posetrack_cli.configuration import load_settings
from posetrack_cli.errors import PosetrackError
from posetrack_cli.evaluation.measuring.evaluate import evaluate
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.outputs import state_path
from posetrack_cli.results import load_arrays, read_result
from support.results import RUN, write_result

POSETRACK = [sys.executable, "-m", "posetrack_cli.cli.main"]
KNOWN = ["--hand-side", "right", "--shape", "average", "--particles", "32", "--set", "output.flush_frames=2"]
"""What need not be found out of a hand: runs start at once."""
FRAMES = 4
CHUNK_S, OVERLAP_S = 1.0, 0.3
LONG_RATE_HZ, LONG_FRAMES = 30.0, 50
"""Two pieces of the shortest that there are."""
TIMEOUT_S = "14"
"""One worker waits for what takes too long, which is begun first, while the other does the rest until it is
killed. What does not take too long takes two seconds, on two busy cores three."""

HOOK = '''
"""Makes things go wrong in the processes of jobs, by the names of recordings, while a file says so."""
import json, os, pathlib, signal, time
loads, here = json.loads, pathlib.Path(__file__).parent
def hooked(text, *more, **options):
    value = loads(text, *more, **options)
    if isinstance(value, dict) and "memory_bytes" in value and (here / "active").exists():
        name = pathlib.Path(value["recording"]).stem
        if name == "aborts":
            os.abort()
        if name == "0-sleeps":
            time.sleep(600)
        if name == "kills" and not (here / "killed").exists():
            (here / "killed").touch()
            os.kill(os.getppid(), signal.SIGKILL)
            time.sleep(600)
    return value
json.loads = hooked
'''


def synth(path: Path, seed: int, *options: str) -> Path:
    told = ["--motion", "C", "--frames", str(FRAMES), "--seed", str(seed), "--no-drops", "-o", str(path)]
    assert run(["hand", "synth", *told, *options]) == 0
    return path


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six, of which one is damaged; the others are of two motions."""
    folder = tmp_path_factory.mktemp("in")
    made = [synth(folder / f"a{seed}.mcap", seed) for seed in (1, 2)]
    shutil.copy(made[0], folder / "0-sleeps.mcap")
    (folder / "day").mkdir()
    for recording, name in zip(made, ("aborts", "kills"), strict=True):
        shutil.copy(recording, folder / "day" / f"{name}.mcap")
    (folder / "damaged.mcap").write_bytes(made[0].read_bytes()[:20_000])
    return folder


@pytest.fixture
def hooked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder whose file ``active`` makes things go wrong in all processes that are started."""
    folder = tmp_path / "hook"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(HOOK)
    (folder / "active").touch()
    before = os.environ.get("PYTHONPATH")
    monkeypatch.setenv("PYTHONPATH", f"{folder}{os.pathsep}{before}" if before else str(folder))
    return folder


@pytest.fixture
def cluster(tmp_path: Path, hooked: Path) -> Iterator[Path]:
    """A scheduler and two workers as processes; the file that the scheduler writes."""
    with started_cluster(tmp_path, workers=2) as file:
        yield file


@contextmanager
def started_cluster(tmp_path: Path, workers: int, **variables: str) -> Iterator[Path]:
    """Start a scheduler and workers, with environment variables; the file that the scheduler writes."""
    file, dask = tmp_path / "scheduler.json", [sys.executable, "-m", "dask"]
    flags = ["--scheduler-file", str(file), "--no-dashboard"]
    commands = [[*dask, "scheduler", "--port", "0", "--host", "127.0.0.1", *flags]]
    commands += [[*dask, "worker", "--nthreads", "1", "--no-nanny", "--host", "127.0.0.1", *flags]] * workers
    with (tmp_path / "cluster.log").open("wb") as log:
        processes = [
            subprocess.Popen(one, stdout=log, stderr=log, cwd=tmp_path, env=os.environ | variables)
            for one in commands
        ]
        try:
            yield file
        finally:
            for one in processes:  # without asking: a worker whose scheduler is gone waits for it
                one.kill()
            for one in processes:
                one.wait()


def states(folder: Path) -> dict[str, str]:
    with (folder / "summary.csv").open(newline="") as stream:
        return {row["name"]: row["state"] for row in csv.DictReader(stream)}


def run_batch(*arguments: str | Path, folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    """A batch as a user starts it, in a folder; the package that lies there is the one that runs."""
    line = [*POSETRACK, "batch", "hand", "run", *map(str, arguments)]
    return subprocess.run(line, capture_output=True, text=True, check=False, cwd=folder)


@dataclass(frozen=True)
class BatchHere:
    """A batch in this process, which need not start; its jobs have processes of their own as ever."""

    capsys: pytest.CaptureFixture[str]

    def __call__(self, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
        line = ["batch", "hand", "run", *map(str, arguments)]
        self.capsys.readouterr()
        code = run(line)
        return subprocess.CompletedProcess(line, code, *self.capsys.readouterr())


@pytest.fixture
def run_here(capsys: pytest.CaptureFixture[str]) -> BatchHere:
    return BatchHere(capsys)


def single(recording: Path, output: Path, *options: str) -> Path:
    assert run(["hand", "run", str(recording), "-o", str(output), *KNOWN, *options]) == 0
    return output


def test_a_cluster_in_which_things_go_wrong(
    recordings: Path, tmp_path: Path, cluster: Path, hooked: Path, run_here: BatchHere
) -> None:
    out, junit = tmp_path / "out", tmp_path / "junit.xml"
    common = [f"{recordings}/**/*.mcap", "-o", out, "--no-reports", *KNOWN]
    done = run_batch(*common, "--scheduler-file", cluster, "--timeout", TIMEOUT_S, "--junit", junit)
    wrong = {"day/aborts", "0-sleeps", "damaged"}
    found = states(out)
    assert len(found) == 6
    assert {name for name, state in found.items() if state != "done"} == wrong, done.stderr
    assert (hooked / "killed").exists()  # a worker died, and another one did its job
    assert done.returncode == 3
    assert "failed: day/aborts: process was killed by SIGABRT" in done.stderr
    assert f"failed: 0-sleeps: exceeded --timeout {TIMEOUT_S} s" in done.stderr
    assert "failed: damaged: " in done.stderr
    failures = {
        case.get("classname") for case in ET.parse(junit).iter("testcase") if case.find("failure") is not None
    }
    assert failures == wrong

    for name, recording in (("a1", "a1"), ("day/kills", "a2")):
        alone = single(recordings / f"{recording}.mcap", tmp_path / f"alone-{recording}.mcap")
        assert read_result(out / f"{name}.mcap").run["input.name"] == f"{Path(name).name}.mcap"
        if name == recording:
            assert filecmp.cmp(out / f"{name}.mcap", alone, shallow=False)
        else:  # its name is part of its record, and nothing else differs
            a, b = load_arrays(out / f"{name}.mcap"), load_arrays(alone)
            assert all(
                np.array_equal(a[key], b[key], equal_nan=True) for key in ("position", "pose_variance")
            )

    (hooked / "active").unlink()
    times = {path: path.stat().st_mtime_ns for path in out.rglob("*.mcap")}
    again = run_here(*common, "--timeout", "600")
    found = states(out)
    assert {name for name, state in found.items() if state == "done"} == {"day/aborts", "0-sleeps"}
    assert {name for name, state in found.items() if state == "failed"} == {"damaged"}
    assert again.returncode == 3
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in times.items())


@pytest.fixture(scope="module")
def long_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("long") / "long.mcap"
    return synth(path, 5, "--frames", str(LONG_FRAMES), "--fps", str(LONG_RATE_HZ))


def test_pieces_give_equal_bytes_for_any_number_of_workers(
    long_recording: Path, tmp_path: Path, run_here: BatchHere
) -> None:
    """And nothing shows where they meet: the error changes there as it does elsewhere."""
    results = []
    for jobs in (1, 4):  # one after the other, or all at once, and workers that have nothing to do
        out = tmp_path / str(jobs)
        pieces = ["--chunk-s", str(CHUNK_S), "--overlap-s", str(OVERLAP_S), "--jobs", str(jobs), "--smooth"]
        done = run_here(long_recording, "-o", out, "--no-reports", *KNOWN, *pieces)
        assert done.returncode == 0, done.stderr
        results.append(out / "long.mcap")
        assert not (out / ".batch" / "records" / "long.pieces").exists()
    assert all(filecmp.cmp(results[0], other, shallow=False) for other in results[1:])
    result = read_result(results[0])
    assert (result.run["pieces"], result.run["chunk_s"]) == ("2", "1")
    for track in result.tracks:
        found = load_arrays(results[0], result.topic_of_track(track))
        assert np.array_equal(np.sort(found["frame_index"]), np.arange(LONG_FRAMES))

    truth = load_arrays(results[0], "/truth/hand/estimate")
    found = load_arrays(results[0])
    errors = found["points"] - truth["points"]
    steps = np.linalg.norm(np.diff(errors, axis=0), axis=2).mean(axis=1)
    seam = round(CHUNK_S * LONG_RATE_HZ) - 1
    assert steps[seam] <= np.delete(steps, seam).max()

    whole = single(long_recording, tmp_path / "whole.mcap")
    error, without = (evaluate(path).metrics["joint_error_mm"].mean for path in (results[0], whole))  # type: ignore[union-attr]
    assert error <= 1.1 * without  # on a few frames; docs/batch.md tells of 3,000


def test_ctrl_c_stops_and_the_same_command_goes_on(
    recordings: Path, long_recording: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    arguments = [
        str(long_recording),
        str(recordings / "a1.mcap"),
        "-o",
        str(out),
        "--jobs",
        "1",
        "--no-reports",
    ]
    line = [*POSETRACK, "batch", "hand", "run", *arguments, *KNOWN, "--particles", "96"]
    with subprocess.Popen(line, stderr=subprocess.PIPE, text=True) as process:
        end_s = time.monotonic() + 120.0
        while not state_path(out / "long.mcap").is_file():  # the first checkpoint: most frames are left
            assert time.monotonic() < end_s
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=120.0)
    assert process.returncode == 130
    assert "interrupted; run the same command again to continue" in said
    assert states(out) == {"long": "stopped", "a1": "stopped"}
    assert state_path(out / "long.mcap").is_file()
    assert subprocess.run(line, check=False, capture_output=True).returncode == 0
    assert states(out) == {"long": "done", "a1": "done"}


@pytest.fixture(scope="module")
def another_build(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a copy of the package, of which one default is another one."""
    folder = tmp_path_factory.mktemp("another")
    for name in ("posetrack_cli", "configs"):
        shutil.copytree(PACKAGE.parent / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    config = folder / "posetrack_cli" / "hand" / "config.py"
    text = config.read_text()
    assert text.count('256, "enough for the guided') == 1
    config.write_text(text.replace('256, "enough for the guided', '8, "enough for the guided'))
    return folder


def test_results_of_another_default_are_not_kept_and_those_of_another_processor_are_told(
    recordings: Path,
    tmp_path: Path,
    another_build: Path,
    run_here: BatchHere,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    line = [recordings / "a1.mcap", "-o", tmp_path / "out", "--no-reports", *KNOWN]
    for state in ("done", "kept"):
        done = run_here(*line)
        assert (done.returncode, states(tmp_path / "out")) == (0, {"a1": state})
        assert "kinds of processor" not in done.stderr
    for folder, way in ((PACKAGE.parent, "keep"), (another_build, "replace")):
        assert run_batch(*line, "--dry-run", folder=folder).stdout.startswith(f"{way}: ")
    features = build.processor_features()
    monkeypatch.setattr(build, "processor_features", lambda: f"{features}, openblas Newest")
    done = run_here(*line)
    assert (done.returncode, states(tmp_path / "out")) == (0, {"a1": "kept"})
    assert "results come from different processor types and may differ in the last digits: " in done.stderr
    assert "openblas Newest" in done.stderr


def test_a_cluster_of_another_build_is_one_line(
    recordings: Path, tmp_path: Path, another_build: Path, run_here: BatchHere
) -> None:
    with started_cluster(tmp_path, workers=1, PYTHONPATH=str(another_build)) as file:
        done = run_here(recordings / "a1.mcap", "-o", tmp_path / "out", *KNOWN, "--scheduler-file", file)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()[-1:]
    assert "worker runs another build of posetrack" in line and f"expected sources {source_digest()}" in line
    assert not (tmp_path / "out" / "a1.mcap").exists()


def test_code_that_changes_under_a_batch_fails_in_one_line(recordings: Path, tmp_path: Path) -> None:
    output, record = tmp_path / "a1.mcap", tmp_path / "a1.json"
    job = Job("a1", ("hand", "run"), recordings / "a1.mcap", (), output, record, tmp_path)
    outcome = run_job(replace(job, sources="of before"), Limits())
    assert outcome.state is State.FAILED
    assert "posetrack on this worker differs from that of the batch" in outcome.reason
    assert "expected of before" in outcome.reason and not job.output.exists()


def test_a_page_has_a_row_for_each_and_links_to_theirs(
    recordings: Path, tmp_path: Path, run_here: BatchHere, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, temporary = tmp_path / "out", tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    done = run_here(
        recordings / "a1.mcap",
        recordings / "damaged.mcap",
        "-o",
        out,
        *KNOWN,
        "--fail-if",
        "joint_error_mm.mean > 0",
    )
    assert done.returncode == 1
    assert "a1: gate 'joint_error_mm.mean > 0' failed" in done.stderr
    page = (out / "index.html").read_text()
    assert 'href="./a1.html"' in page
    assert '<section id="worst">' in page and 'alt="a1, frame ' in page  # from the page of the result
    assert (out / "a1.html").is_file()
    assert "Recordings without a result (1)" in page
    report = json.loads((out / "summary.json").read_text())
    assert [one["name"] for one in report["recordings"]] == ["damaged", "a1"]
    assert [one["gate"] for one in report["gates"]] == ["tracked", "tracked", "joint_error_mm.mean > 0"]
    assert "2 of 3 gates failed." in page
    assert not list(temporary.iterdir())  # Dask leaves nothing there
    assert not (out / ".batch" / "scratch").exists()
    again = run_here(
        recordings / "a1.mcap", "-o", out, *KNOWN, "--baseline", out / "summary.json", "--markdown", "-"
    )
    assert again.returncode == 0, again.stderr  # it is as good as before
    assert "posetrack eval" in again.stdout


def test_memory_that_is_not_there_fails_one_recording(
    recordings: Path, tmp_path: Path, run_here: BatchHere
) -> None:
    """Numbers of particles that no window of memory holds fail alone, by a line."""
    manifest = tmp_path / "set.toml"
    a1, a2 = recordings / "a1.mcap", recordings / "a2.mcap"
    manifest.write_text(
        f'[[recordings]]\npath = "{a1}"\noptions = {{ particles = 400000 }}\n[[recordings]]\npath = "{a2}"\n'
    )
    done = run_here(manifest, "-o", tmp_path / "out", "--no-reports", "--memory-limit", "700M", *KNOWN)
    assert done.returncode == 3, done.stderr
    assert states(tmp_path / "out") == {"a1": "failed", "a2": "done"}
    assert "memory" in done.stderr


def test_a_dry_run_changes_nothing(
    recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["batch", "hand", "run", f"{recordings}/a*.mcap", "-o", str(tmp_path / "out"), "--dry-run"]
    assert run(arguments) == 0
    assert capsys.readouterr().out.count("track: ") == 2
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nothing/*.mcap"], "no matching recording"),
        (["{a1}", "{a1}"], "two recordings have the same result name"),
        (["{a1}", "--scheduler", "tcp://127.0.0.1:9", "--scheduler-file", "x"], "mutually exclusive"),
        (["{a1}", "--hand-side", "middle"], "'middle' is not one of"),
        (["{a1}", "--memory-limit", "much"], "'much' is not a size such as 2G"),
        (["{a1}", "--memory-limit", "1M"], "1M is too small; a run needs at least 512M"),
        (["{a1}", "--fail-if", "joint_eror_mm.mean > 3"], "joint_eror_mm"),
        (["{a1}", "--resume"], "No such option '--resume'"),
        (["{manifest}"], "unknown option 'hand-sid'; did you mean 'hand-side'?"),
    ],
)
def test_bad_input_is_one_line(
    recordings: Path, tmp_path: Path, arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    manifest = tmp_path / "set.toml"
    path = recordings / "a1.mcap"
    manifest.write_text(f'[[recordings]]\npath = "{path}"\noptions = {{ hand-sid = "left" }}\n')
    filled = [one.format(a1=path, manifest=manifest) for one in arguments]
    assert run(["batch", "hand", "run", *filled, "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1


def test_a_recording_called_index_keeps_its_page_from_the_batchs_own(
    recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "day").mkdir()
    for place in (tmp_path, tmp_path / "day"):
        shutil.copy(recordings / "a1.mcap", place / "index.mcap")
    dry = ["batch", "hand", "run", "-o", str(tmp_path / "out"), "--dry-run"]
    assert run([*dry, str(tmp_path / "index.mcap")]) == 2
    said = capsys.readouterr().err
    assert (
        f"{tmp_path / 'index.mcap'}: its page would overwrite a file of the batch, found index.html" in said
    )
    assert run([*dry, str(tmp_path / "index.mcap"), "--no-reports"]) == 0
    assert run([*dry, f"{tmp_path}/*/index.mcap"]) == 0  # below a folder it is another page


@pytest.mark.parametrize(
    ("first", "second", "words"),
    [
        ("a", "a.mcap/b", "its folder would overwrite the result of {first}, found a.mcap"),
        ("a", "a.html/b", "its folder would overwrite the page of {first}, found a.html"),
        ("a", "summary.csv/b", "its folder would overwrite a file of the batch, found summary.csv"),
        ("a", ".batch/b", "its folder would overwrite a file of the batch, found .batch"),
        ("a", "A", "its result would overwrite the result of {first}, found A.mcap"),
        ("lock", "lock/b", ""),
        ("records", "records/records", ""),
        ("a", "a.pieces/00000", ""),
    ],
)
def test_results_that_would_meet_are_refused(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    first: str,
    second: str,
    words: str,
) -> None:
    """Also names that are one where a file system takes capitals for small letters."""
    from posetrack_cli.cli import batch

    def track(plan: object, options: object) -> list[Outcome]:
        raise PosetrackError("would be tracked")

    monkeypatch.setattr(batch, "_folds_case", lambda folder: True)
    monkeypatch.setattr(batch, "_run", track)
    made = [tmp_path / name for name in ("one.mcap", "two.mcap")]
    for path in made:
        path.touch()
    manifest = tmp_path / "set.toml"
    tables = [
        f'[[recordings]]\npath = "{p}"\nname = "{n}"\n' for p, n in zip(made, (first, second), strict=True)
    ]
    manifest.write_text("".join(tables))
    code = run(["batch", "hand", "run", str(manifest), "-o", str(tmp_path / "out")])
    said = capsys.readouterr().err
    assert (words.format(first=made[0]) or "would be tracked") in said
    assert (code, said.count("\n")) == (2 if words else 1, 1)


def test_a_file_system_that_keeps_capitals_apart_is_told(tmp_path: Path) -> None:
    from posetrack_cli.cli.batch import _folds_case

    (tmp_path / ".batch").mkdir()
    assert not _folds_case(tmp_path)
    (tmp_path / ".BATCH").mkdir()  # stands in for the other kind, which shows one folder by both names
    assert _folds_case(tmp_path)


def test_a_folder_of_results_that_holds_links_is_refused(
    recordings: Path, tmp_path: Path, run_here: BatchHere
) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out" / ".batch").symlink_to(tmp_path / "elsewhere")
    done = run_here(recordings / "a1.mcap", "-o", tmp_path / "out", *KNOWN)
    assert done.returncode == 2
    assert f"{tmp_path / 'out' / '.batch'}: is a symbolic link; refusing to write through it" in done.stderr
    assert not list((tmp_path / "elsewhere").iterdir())


def test_a_dashboard_needs_bokeh(
    recordings: Path, tmp_path: Path, run_here: BatchHere, monkeypatch: pytest.MonkeyPatch
) -> None:
    from posetrack_cli.batch import engine

    monkeypatch.setattr(engine, "find_spec", lambda name: None)
    done = run_here(recordings / "a1.mcap", "-o", tmp_path / "out", "--dashboard", *KNOWN)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "--dashboard needs Bokeh, which is not installed; pip install bokeh" in done.stderr


def test_a_scheduler_that_is_not_there_is_one_line(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from posetrack_cli.batch import engine

    monkeypatch.setattr(engine, "CONNECT_S", 0.5)
    line = ["batch", "hand", "run", str(recordings / "a1.mcap"), "-o", str(tmp_path / "out")]
    assert run([*line, "--scheduler-file", str(tmp_path / "gone.json")]) == 1
    said = capsys.readouterr().err
    assert "gone.json: no Dask scheduler responds, found no such file after 0.5 s" in said


def test_without_dask_one_line_says_what_to_install(recordings: Path, tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text("import sys\nsys.modules['dask'] = None\n")
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    }
    line = [*POSETRACK, "batch", "hand", "run", str(recordings / "a1.mcap"), "-o", str(tmp_path / "out")]
    done = subprocess.run(line, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "pip install 'posetrack[batch]'" in done.stderr


def test_batches_on_one_machine_do_not_meet_and_nobody_else_reaches_them() -> None:
    """Their ports are not those of each other, which Dask would warn of, and not open to the network."""
    from posetrack_cli.batch.engine import EngineOptions, open_engine

    def unreachable(*_: object) -> Outcome:
        raise AssertionError

    with open_engine(EngineOptions(), unreachable), open_engine(EngineOptions(jobs=2), unreachable):
        addresses = listening_addresses()
    assert addresses == {"127.0.0.1"}


def listening_addresses() -> set[str]:
    """Of all sockets on which this process waits for others."""
    found = set()
    for path in filter(Path.is_socket, Path("/proc/self/fd").iterdir()):
        with socket.socket(fileno=os.dup(int(path.name))) as one:
            if one.family != socket.AF_UNIX and one.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
                found.add(one.getsockname()[0])
    return found


def test_two_batches_do_not_share_a_folder(recordings: Path, tmp_path: Path, run_here: BatchHere) -> None:
    from posetrack_cli.files import open_output
    from posetrack_cli.outputs import lock

    (tmp_path / "out" / ".batch").mkdir(parents=True)
    with open_output(tmp_path / "out" / ".batch" / "lock") as stream:
        lock(stream)
        done = run_here(recordings / "a1.mcap", "-o", tmp_path / "out", *KNOWN)
    assert done.returncode == 2
    assert "output folder is in use by another batch" in done.stderr


@pytest.mark.parametrize("command", BATCH_COMMANDS.values(), ids=lambda one: " ".join(one.words))
def test_no_option_of_a_command_is_hidden_by_one_of_the_batch(command: object) -> None:
    names = {name for one in BATCH_OPTIONS for name in (*one.opts, *one.secondary_opts, str(one.name))}
    own = [name for one in command.parameters for name in (*one.opts, *one.secondary_opts, str(one.name))]  # type: ignore[attr-defined]
    assert not names & set(own)


@pytest.mark.parametrize(
    ("words", "given", "added"),
    [
        (("hand", "run"), ["--seed=1"], ["--shape=r/a.person.toml"]),
        (("hand", "run"), ["--shape=average"], []),
        (("hand", "run"), ["--scale=0.9"], []),
        (("head", "mono"), ["--passes=1"], ["--person=a.mcap"]),
        (("head", "mono"), ["--faces=all"], []),
        (("head", "mono"), ["--load-model=m"], []),
        (("head", "stereo"), [], []),
    ],
    ids=str,
)
def test_what_is_known_of_a_person_does_not_override_options(
    words: tuple[str, str], given: list[str], added: list[str]
) -> None:
    """Nor does stereo, which measures each face, take one from another recording."""
    command = BATCH_COMMANDS[words]
    first = Job("a", words, Path("in.mcap"), (), Path("a.mcap"), Path("r/a.json"), Path())
    assert list(command.of_person(given, first)) == [*given, *added]
    command.check(command.of_person(given, first))


def test_a_person_s_hand_is_the_mean_of_results(tmp_path: Path) -> None:
    """As a configuration, which says nothing of the side."""
    jobs = [
        Job(name, ("hand", "run"), tmp_path, (), tmp_path / f"{name}.mcap", tmp_path / "a.json", tmp_path)
        for name in ("a", "b")
    ]
    for job, scale in zip(jobs, (0.9, 1.0), strict=True):
        hand = {"side": "left", "scale": scale}
        write_result(job.output, 1, run=RUN | {"configuration": json.dumps({"hand": hand})})
    command = BATCH_COMMANDS["hand", "run"]
    assert command.share(jobs)
    config = load_settings(HandConfig, tmp_path / "a.person.toml", {})
    assert config.hand.scale == round(float(np.sqrt(0.9)), 4) and config.hand.side == "auto"
    jobs[1].output.unlink()
    assert not command.share(jobs)
