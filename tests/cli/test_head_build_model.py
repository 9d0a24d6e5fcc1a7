"""``posetrack head build-model``: the tables, the model, the picture, and what is refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.head.multilinear.face_model import load_face_model
from support.face_people import people, performance, write_stereo_result


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("people")
    faces = enumerate(people(5))
    return [write_stereo_result(folder / f"p{k}.mcap", performance(face, 300)) for k, face in faces]


def build(*arguments: object) -> int:
    return run(["head", "build-model", *map(str, arguments)])


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and "Traceback" not in lines[0]
    return lines[0]


def test_tables_model_and_picture(
    results: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output, picture = tmp_path / "face.npz", tmp_path / "face.png"
    assert build(*results, "-o", output, "--picture", picture) == 0
    said = capsys.readouterr()
    lines = said.out.splitlines()
    rows = [line.split() for line in lines if line.startswith("p")][1:]
    assert [row[0] for row in rows] == [path.name for path in results]
    assert all(row[1:3] == ["300", "300"] and len(row) == 3 + 2 * (3 + 5) for row in rows)
    errors = next(line for line in lines if line.startswith("approximation, rms mm")).split()[3:]
    assert len(errors) == 5 and all(0.0 <= float(error) < 1.0 for error in errors)
    shares = next(line for line in lines if line.startswith("identity ")).split()[1:]
    numbers = [float(word) for word in shares if word != "|"]
    assert numbers == sorted(numbers) and numbers[-1] == 100.0
    assert lines[-1] == f"{output}: identity 10, deformation 5" and not said.err
    model = load_face_model(output)
    assert (model.identity_size, model.deformation_size) == (10, 5)
    drawn = cv2.imread(str(picture))
    assert drawn is not None and drawn.shape[0] > 500 and drawn.shape[1] > 1000


def test_the_same_results_give_the_same_bytes(results: list[Path], tmp_path: Path) -> None:
    for name in ("a", "b"):
        assert build(*results, "-o", tmp_path / f"{name}.npz", "--picture", tmp_path / f"{name}.png") == 0
    for suffix in ("npz", "png"):
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


def test_few_people_tell_of_few_parameters(
    results: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "face.npz"
    assert build(*results[:2], "-o", output, "--deformation-size", "4") == 0
    said = capsys.readouterr()
    assert said.err.strip() == "identity: 4 instead of 10 parameters, the most for 2 people"
    assert said.out.splitlines()[-1] == f"{output}: identity 4, deformation 4"


def test_one_person_is_refused(
    results: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert build(results[0], "-o", tmp_path / "face.npz") == 2
    assert "too few people, found 1" in one_line(capsys)


def test_who_shows_too_little_is_named(
    results: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    still = write_stereo_result(tmp_path / "still.mcap", np.repeat(people(1), 60, axis=0))
    assert build(*results, still, "-o", tmp_path / "face.npz") == 1
    assert f"{still}: too little of the motion 'mouth sideways'" in one_line(capsys)
    assert not (tmp_path / "face.npz").exists()


def test_existing_files_are_kept(
    results: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output, picture = tmp_path / "face.npz", tmp_path / "face.png"
    for there in (output, picture):
        there.write_text("precious")
        assert build(*results, "-o", output, "--picture", picture) == 2
        assert f"{there}: already exists" in one_line(capsys)
        assert there.read_text() == "precious"
        there.unlink()
    output.write_text("old")
    assert build(*results, "-o", output, "--overwrite") == 0
    assert load_face_model(output).identity_size == 10


def test_names_that_cannot_be_meant(
    results: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "face.npz"
    assert build(*results, "-o", output, "--picture", tmp_path / "face.jpg") == 2
    assert "expected a name ending in .png" in one_line(capsys)
    assert build(*results, "-o", tmp_path / "a.png", "--picture", tmp_path / "a.png") == 2
    assert "--output and --picture are the same file" in one_line(capsys)
    other_name = results[0].parent / "." / ".." / results[0].parent.name / results[0].name
    for again in (results[0], other_name):
        assert build(again, *results, "-o", output) == 2
        assert "result given twice" in one_line(capsys)
    assert build(*results, "-o", results[0], "--overwrite") == 2
    assert "output would replace the result" in one_line(capsys)
    assert build(tmp_path / "none.mcap", *results, "-o", output) == 1
    assert "none.mcap" in one_line(capsys)
    text = tmp_path / "text.mcap"
    text.write_text("no result")
    assert build(text, *results, "-o", output) == 1
    assert f"{text}: " in one_line(capsys)
    assert not output.exists()
