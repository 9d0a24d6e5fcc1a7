"""Configuration: defaults < file < options, and every mistake is named on one line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import Field, ValidationError

from posetrack_cli.configuration import (
    Settings,
    find_configuration,
    load_settings,
    parse_assignments,
    validated,
)
from posetrack_cli.errors import UsageError
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig


class Inner(Settings):
    particles: Annotated[int, Field(ge=1)] = 512
    spread_mm: float = 2.0


class Outer(Settings):
    name: str = "a"
    filter: Inner = Inner()
    other: Inner | None = None


def written(folder: Path, text: str) -> Path:
    path = folder / "run.toml"
    path.write_text(text)
    return path


def failure(path: Path | None, options: dict[str, object] | None = None) -> str:
    with pytest.raises(UsageError) as caught:
        load_settings(Outer, path, options or {})
    line = str(caught.value)
    assert "\n" not in line
    return line


def test_defaults_then_file_then_options(tmp_path: Path) -> None:
    path = written(tmp_path, 'name = "file"\n[filter]\nparticles = 7\nspread_mm = 5.0\n')
    assert load_settings(Outer, None, {}) == Outer()
    options = {"filter.particles": 9, "filter.spread_mm": None, "name": None, "other.spread_mm": 1.0}
    expected = Outer(name="file", filter=Inner(particles=9, spread_mm=5.0), other=Inner(spread_mm=1.0))
    assert load_settings(Outer, path, options) == expected


def test_a_table_given_in_part_keeps_the_other_defaults(tmp_path: Path) -> None:
    """Also where the table's own fields have none: --set motion.pose.position_mm=50 sets any key."""
    path = written(tmp_path, "[motion.pose]\nposition_mm = 30.0\n[init.velocity]\nrotation_rad = 0.5\n")
    config = load_settings(HandConfig, path, {"motion.pose.flexion_rad": 2.0, "motion.gap_max_s": 3.0})
    default = HandConfig()
    pose = default.motion.pose.model_copy(update={"position_mm": 30.0, "flexion_rad": 2.0})
    velocity = default.init.velocity.model_copy(update={"rotation_rad": 0.5})
    assert config.motion == default.motion.model_copy(update={"pose": pose, "gap_max_s": 3.0})
    assert config.init == default.init.model_copy(update={"velocity": velocity})
    with pytest.raises(UsageError, match=r"unknown configuration key 'motion.pose.flexion'"):
        load_settings(HandConfig, None, {"motion.pose.flexion": 2.0})


@pytest.mark.parametrize("value", [1e300, 1e-300, -1.0])
@pytest.mark.parametrize(
    "key", ["hand.scale", "observation.sigma_mm", "observation.clamp_mm", "init.depth_mm"]
)
def test_sizes_that_no_hand_or_camera_has_are_refused(key: str, value: float) -> None:
    with pytest.raises(UsageError, match=rf"'{key}' cannot be used"):
        load_settings(HandConfig, None, {key: value})


def test_frozen_and_finite() -> None:
    with pytest.raises(ValidationError):
        Outer().name = "b"
    with pytest.raises(UsageError, match=r"'filter.spread_mm' cannot be used, found nan"):
        validated(Outer, {"filter": {"spread_mm": float("nan")}}, "options")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nmae = 'x'", "unknown configuration key 'nmae'; did you mean 'name'?"),
        ("[filter]\npartcles = 3", "unknown configuration key 'filter.partcles'; did you mean 'particles'?"),
        ("[other]\nspred_mm = 3", "unknown configuration key 'other.spred_mm'; did you mean 'spread_mm'?"),
        ("[filter]\nzzz = 3", "unknown configuration key 'filter.zzz'; known: particles, spread_mm"),
        ("filter = 3", "'filter' cannot be used, found 3, expected a table of settings"),
        ("filter = true", "'filter' cannot be used, found True, expected "),
        ("filter = ", "not a TOML file, found "),
    ],
)
def test_mistakes_in_a_file(tmp_path: Path, text: str, message: str) -> None:
    path = written(tmp_path, text)
    assert failure(path).startswith(f"{path}: {message}")


@pytest.mark.parametrize("as_option", [False, True])
@pytest.mark.parametrize(
    ("former", "current"),
    [
        ("sure_mm", "doubt_above_mm"),
        ("well_mm", "retry_above_mm"),
        ("good_mm", "baseline_cost_mm"),
    ],
)
def test_a_renamed_key_is_refused_with_its_new_name(
    tmp_path: Path, former: str, current: str, as_option: bool
) -> None:
    path = None if as_option else written(tmp_path, f"[status]\n{former} = 3.0\n")
    options = {f"status.{former}": 3.0} if as_option else {}
    message = f"configuration key 'status.{former}' was renamed; use 'status.{current}'"
    with pytest.raises(UsageError, match=message):
        load_settings(HandConfig, path, options)


class Every(Settings):
    """One field of each kind that configurations have."""

    count: Annotated[int, Field(ge=1)] = 1
    size_mm: Annotated[float, Field(gt=0.0)] = 1.0
    share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.5
    below: Annotated[float, Field(lt=2.5)] = 0.5
    window_px: Annotated[int, Field(ge=8, le=4096)] | None = None
    kind: Literal["rbpf", "pf"] = "pf"
    name: str = ""
    switch: bool = False
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    angles: Annotated[tuple[float, ...], Field(min_length=2, max_length=2)] = (0.0, 0.0)


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("count", "many", "a whole number"),
        ("count", 2.5, "a whole number"),
        ("count", [1], "a whole number"),
        ("count", 0, "1 or more"),
        ("size_mm", "wide", "a number"),
        ("size_mm", {}, "a number"),
        ("size_mm", 0.0, "more than 0"),
        ("size_mm", float("inf"), "a finite number"),
        ("share", 1.5, "1 or less"),
        ("below", 2.5, "less than 2.5"),
        ("window_px", 4097, "4096 or less"),
        ("window_px", "x", "a whole number"),
        ("kind", "kf", "'rbpf' or 'pf'"),
        ("name", 3, "text"),
        ("switch", "perhaps", "true or false"),
        ("switch", [], "true or false"),
        ("point", 3.0, "a list of values"),
        ("point", [], "3 values"),
        ("point", [1.0, 2.0], "3 values"),
        ("point", [1.0, 2.0, 3.0, 4.0], "3 values"),
        ("angles", [1.0], "2 values"),
        ("angles", [1.0, 2.0, 3.0], "2 values"),
        ("count", True, "a value other than true or false"),
        ("size_mm", False, "a value other than true or false"),
        ("window_px", True, "a value other than true or false"),
        ("point", [True, 2.0, 3.0], "a value other than true or false"),
    ],
)
def test_what_was_expected_is_said_in_plain_words(key: str, value: object, expected: str) -> None:
    with pytest.raises(UsageError) as caught:
        validated(Every, {key: value}, "options")
    line = f"options: '{key}' cannot be used, found {value!r}, expected {expected}"
    assert str(caught.value) == line


def test_one_value_of_a_list_is_named_by_its_place() -> None:
    with pytest.raises(
        UsageError, match=r"^options: 'point.1' cannot be used, found 'x', expected a number$"
    ):
        validated(Every, {"point": [1.0, "x", 2.0]}, "options")


def test_a_key_without_a_default_is_missing() -> None:
    class Needed(Settings):
        position_mm: tuple[float, float, float]

    with pytest.raises(UsageError, match=r"^options: 'position_mm' is missing$"):
        validated(Needed, {}, "options")


def test_what_can_be_meant_is_taken() -> None:
    given = {"count": 2.0, "size_mm": "3", "switch": True, "point": [1, 2, 3], "name": "true"}
    expected = Every(count=2, size_mm=3.0, switch=True, point=(1.0, 2.0, 3.0), name="true")
    assert validated(Every, given, "options") == expected


def test_mistakes_in_options(tmp_path: Path) -> None:
    assert failure(None, {"filter.particles": 0}).startswith("options: 'filter.particles' cannot be used")
    # a value stands where the option needs a table: the file's mistake is told, not a traceback
    path = written(tmp_path, "filter = 3")
    assert failure(path, {"filter.particles": 5}).startswith(f"{path}: 'filter' cannot be used, found 3")


def test_assignments_are_toml_values_or_plain_text() -> None:
    given = ["filter.particles=9", " name = plain text", "a=[1, 2]", 'b="x=y"', "c=true"]
    expected = {"filter.particles": 9, "name": "plain text", "a": [1, 2], "b": "x=y", "c": True}
    assert parse_assignments(given) == expected
    for wrong in ("filter.particles", "=3", " =3"):
        with pytest.raises(UsageError, match="not an assignment"):
            parse_assignments([wrong])


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    missing = tmp_path / "none.toml"
    assert failure(missing) == f"{missing}: configuration cannot be read, found No such file or directory"
    assert "configuration cannot be read" in failure(tmp_path)
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    assert failure(binary).startswith(f"{binary}: not a TOML file")


def test_a_configuration_is_found_by_path_or_by_name(tmp_path: Path) -> None:
    path = written(tmp_path, "")
    assert find_configuration(path) == path
    assert find_configuration("hand").name == "hand.toml"
    with pytest.raises(UsageError, match=r"^hnad: no such configuration.* did you mean 'hand'\?$"):
        find_configuration("hnad")


DEFAULTS = {"hand": HandConfig, "head-stereo": HeadStereoConfig, "head-mono": HeadMonoConfig}


@pytest.mark.parametrize("name", DEFAULTS)
def test_a_shipped_configuration_states_every_default(name: str) -> None:
    path, defaults = find_configuration(name), DEFAULTS[name]()
    assert load_settings(DEFAULTS[name], path, {}) == defaults
    # None cannot be written in TOML: such a key stands in a comment
    optional = {key for key, value in leaves(defaults.model_dump()).items() if value is None}
    assert set(leaves(defaults.model_dump())) - optional == set(leaves(tomllib_of(path)))


def test_the_thesis_of_one_camera_knows_its_points_alone() -> None:
    """Also in the second pass, which a run makes unless it is told otherwise."""
    printed = load_settings(HeadMonoConfig, find_configuration("head-mono-paper"), {})
    assert not printed.skin.use and not printed.adjustment.offsets and not printed.refinement.joint
    assert (printed.particles.weighting, printed.refinement.recalculation) == ("printed", "printed")


def test_every_shipped_configuration_can_be_loaded() -> None:
    kinds: dict[str, type[Settings]] = {**DEFAULTS}
    for path in find_configuration("hand").parent.glob("*.toml"):
        (kind,) = (kinds[name] for name in kinds if path.stem == name or path.stem.startswith(f"{name}-"))
        load_settings(kind, path, {})


def tomllib_of(path: Path) -> dict[str, object]:
    import tomllib

    return tomllib.loads(path.read_text())


def leaves(table: dict[str, object], prefix: str = "") -> dict[str, object]:
    found: dict[str, object] = {}
    for key, value in table.items():
        found |= leaves(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return found


def test_later_files_override_earlier_ones_table_by_table(tmp_path: Path) -> None:
    first, second = tmp_path / "first.toml", tmp_path / "second.toml"
    first.write_text("[filter]\nparticles = 100\n[hand]\nscale = 1.1\nside = 'left'\n")
    second.write_text("[hand]\nscale = 0.9\n[motion.pose]\nflexion_rad = 2.0\n")
    config = load_settings(HandConfig, [first, second], {"hand.palm_width": 1.2})
    assert (config.filter.particles, config.hand.side, config.hand.scale) == (100, "left", 0.9)
    assert config.hand.palm_width == 1.2
    assert config.motion.pose.position_mm == HandConfig().motion.pose.position_mm
    assert load_settings(HandConfig, [second, first], {}).hand.scale == 1.1
    assert load_settings(HandConfig, [], {}) == HandConfig()


def test_an_error_names_the_file_that_it_is_in(tmp_path: Path) -> None:
    good, bad = tmp_path / "good.toml", tmp_path / "bad.toml"
    good.write_text("[hand]\nscale = 1.1\n")
    bad.write_text("[hand]\nscale = 'large'\n")
    for files in ([good, bad], [bad, good]):
        with pytest.raises(UsageError, match=r"bad\.toml: 'hand\.scale' cannot be used"):
            load_settings(HandConfig, files, {})


def test_a_file_named_in_a_file_lies_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "hand.toml"
    path.write_text("[hand]\nmesh = 'meshes/mine.glb'\n")
    assert load_settings(HandConfig, path, {}).hand.mesh == str(tmp_path / "meshes" / "mine.glb")
    assert load_settings(HandConfig, path, {"hand.mesh": "other.glb"}).hand.mesh == "other.glb"  # as is
    path.write_text(f"[hand]\nmesh = '{tmp_path}/x.glb'\n")
    assert load_settings(HandConfig, path, {}).hand.mesh == f"{tmp_path}/x.glb"
