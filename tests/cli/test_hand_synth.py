from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader

from posetrack_cli.cli.synth import SWITCHES, hand_synth, synth_options
from posetrack_cli.errors import PosetrackError, UsageError
from posetrack_cli.hand.model.hand import average_hand
from posetrack_cli.synthesis.hand.frames import make_plan
from posetrack_cli.synthesis.hand.options import SWITCH_NAMES, Switches, hand_of_seed
from posetrack_cli.synthesis.recording import SYNTH_RECORD

OFF = dict.fromkeys(SWITCH_NAMES)


def invoke(*arguments: str) -> str:
    result = CliRunner().invoke(hand_synth, list(arguments), catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def test_it_writes_a_recording_and_says_so(tmp_path: Path) -> None:
    out = tmp_path / "a.mcap"
    line = invoke("-o", str(out), "--motion", "A", "--frames", "3")
    assert line.startswith(f"{out}: 3 frames, 0 dropped, 0.067 s long, made in ")
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_every_switch_has_an_option_and_every_option_is_meant() -> None:
    assert tuple(name for name, _ in SWITCHES) == SWITCH_NAMES
    off = dict.fromkeys(SWITCH_NAMES)
    assert synth_options({"motion": "C", **off}).switches == Switches.all_on()
    assert synth_options({"motion": "A", **off}).switches == Switches()
    for name in SWITCH_NAMES:
        assert getattr(synth_options({"motion": "A", **off, name: True}).switches, name)
        assert not getattr(synth_options({"motion": "C", **off, name: False}).switches, name)


@pytest.mark.parametrize(
    ("option", "value"),
    [("--frames", "0"), ("--speed", "-1"), ("--fps", "0"), ("--scale", "0")],
)
def test_bad_values_are_wrong_usage_and_write_nothing(tmp_path: Path, option: str, value: str) -> None:
    with pytest.raises(UsageError, match=f"invalid {option}"):
        invoke("-o", str(tmp_path / "a.mcap"), "--motion", "C", option, value)
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_motion_is_wrong_usage(tmp_path: Path) -> None:
    result = CliRunner().invoke(hand_synth, ["-o", str(tmp_path / "a.mcap"), "--motion", "D"])
    assert result.exit_code == 2


def test_unwritable_output_is_an_error_of_ours(tmp_path: Path) -> None:
    with pytest.raises(PosetrackError, match="cannot be written"):
        invoke("-o", str(tmp_path / "no" / "a.mcap"), "--motion", "A", "--frames", "1")


def test_overwrite_replaces(tmp_path: Path) -> None:
    out = tmp_path / "a.mcap"
    arguments = ("-o", str(out), "--motion", "a", "--frames", "1")
    invoke(*arguments)
    with pytest.raises(UsageError, match="already exists"):
        invoke(*arguments)
    invoke(*arguments, "--overwrite")


def synth_record_of(path: Path) -> dict[str, str]:
    with path.open("rb") as stream:
        return next(m.metadata for m in make_reader(stream).iter_metadata() if m.name == SYNTH_RECORD)


def test_a_random_hand_is_of_the_seed_and_written_down(tmp_path: Path) -> None:
    records = []
    for name, more in (("a", ["--seed", "3"]), ("b", ["--seed", "3"]), ("c", ["--seed", "4"])):
        arguments = [
            "-o",
            str(tmp_path / f"{name}.mcap"),
            "--motion",
            "C",
            "--frames",
            "2",
            "--random-hand",
            *more,
        ]
        invoke(*arguments)
        records.append(synth_record_of(tmp_path / f"{name}.mcap"))
    assert records[0] == records[1] and records[0] != records[2]
    shape = hand_of_seed(3)
    assert float(records[0]["scale"]) == shape.scale and 0.85 <= shape.scale <= 1.15
    assert records[0]["finger_widths"] == str(shape.finger_widths)
    segments = np.array(records[0]["anatomy.segments_mm"].split(), dtype=float).reshape(5, 3)
    wanted = average_hand("right", shape).anatomy.segments
    np.testing.assert_allclose(segments, wanted, rtol=1e-5)  # six digits are written


def test_a_random_hand_moves_as_the_usual_one_does() -> None:
    plain, other = (
        make_plan(synth_options({"motion": "C", "frames": 20, "seed": 3, "random_hand": random, **OFF}))
        for random in (False, True)
    )
    np.testing.assert_array_equal(plain.motion.poses[:, 3:], other.motion.poses[:, 3:])
    assert (plain.anatomy.segments != other.anatomy.segments).all()


def test_the_shape_s_options_reach_the_hand() -> None:
    given = {"finger_lengths": (1.0, 1.1, 1.0, 1.0, 1.0), "palm_width": 0.9, "scale": 1.2, "thumb_place": 1.5}
    options = synth_options({"motion": "A", **given, **OFF})
    assert {name: getattr(options.shape, name) for name in given} == given


@pytest.mark.parametrize(
    ("option", "values"),
    [
        ("--finger-lengths", ["1", "1", "2", "1", "1"]),
        ("--finger-widths", ["1", "1", "1", "1", "0"]),
        ("--palm-width", ["3"]),
        ("--wrist-width", ["0.1"]),
        ("--thumb-place", ["9"]),
    ],
)
def test_shapes_beyond_hands_are_wrong_usage(tmp_path: Path, option: str, values: list[str]) -> None:
    with pytest.raises(UsageError, match=f"invalid {option}"):
        invoke("-o", str(tmp_path / "a.mcap"), option, *values)


def test_a_random_hand_has_no_size_of_one_s_own(tmp_path: Path) -> None:
    with pytest.raises(
        UsageError,
        match=r"--random-hand cannot be combined .*, found --palm-width",
    ):
        invoke("-o", str(tmp_path / "a.mcap"), "--random-hand", "--palm-width", "1.1")


def test_a_hand_that_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"none\.glb: cannot be read"):
        invoke("-o", str(tmp_path / "a.mcap"), "--hand-mesh", str(tmp_path / "none.glb"))
    assert list(tmp_path.iterdir()) == []
