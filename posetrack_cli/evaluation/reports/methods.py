"""Methods paragraph of a result for publications, and the command that repeats its run."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping
from typing import Any

from posetrack_cli.errors import PosetrackError, ResultError
from posetrack_cli.recording.base import CAMERA_FILE_KEY, RECORDING_KEY
from posetrack_cli.recording.camera_of import guess_of_camera
from posetrack_cli.recording.camera_record import camera_from_json
from posetrack_cli.results.estimate import Status
from posetrack_cli.results.reader import Result

HAND = (
    "Kajihara and Tanaka, 3D hand pose tracking with a Rao-Blackwellized particle filter",
    "Oikonomidis, Kyriazis and Argyros, Efficient model-based 3D tracking of hand articulations using "
    "Kinect, BMVC 2011",
)
HEAD = (
    "Sugano, User-independent techniques for real-time estimation of non-rigid 3D head motion, 2007",
    "Weng, Zhang and Hwang, Candid covariance-free incremental principal component analysis, PAMI 2003",
    "ICT-FaceKit, USC Institute for Creative Technologies",
)
COMMANDS = {"hand": "hand run", "head-stereo": "head stereo", "head-mono": "head mono"}
# Options of a run that its record states, besides the configuration
OPTIONS = {
    "seed": "--seed",
    "start": "--start",
    "end": "--end",
    "stride": "--stride",
    "init": "--init",
    "face": "--face",
    "input.fps": "--fps",
    "input.depth_unit_mm": "--depth-unit-mm",
}
_DIGEST = ".sha256"
DEFAULTS = {"seed": "0", "start": "0", "stride": "1", "init": "auto", "face": "1"}


def methods(result: Result) -> str:
    """Return a paragraph for publications, the command that repeats the run, and the works to cite.

    It states tracker, version, settings, input and the share of tracked frames, all from the result.

    Raises:
        ResultError: the run record is incomplete.
    """
    status = result.columns(fields=("status",))["status"]
    try:
        return methods_of(result.run, int((status != Status.LOST.value).sum()), len(status))
    except ValueError as error:
        raise ResultError("run record cannot be read", where=result.path, found=error) from error


def methods_of(run: Mapping[str, str], tracked: int, frames: int) -> str:
    """Return the text of ``methods`` from a run record and the numbers of tracked and all frames.

    Raises:
        ValueError: the run record is incomplete.
    """
    try:
        configuration = json.loads(run["configuration"])
        what, cited = _tracker(run, configuration)
        paragraph = f"{what} {_frames(tracked, frames)} {_software(run)}"
        command = f"Command: {shlex.join(_command(run, configuration))}"
    except (KeyError, TypeError, AttributeError, RecursionError, PosetrackError) as error:
        raise ValueError(str(error)) from error
    files = [
        key.removesuffix(_DIGEST) for key in sorted(run) if key.endswith(_DIGEST) and key != RECORDING_KEY
    ]
    files += ["camera"] if f"input.{CAMERA_FILE_KEY}" in run else []
    if files:
        command += f"\nTo be added: the options of the files that this run was given ({', '.join(files)})."
    return "\n\n".join((paragraph, command, "\n".join(f"[{k}] {one}." for k, one in cited)))


def _tracker(run: Mapping[str, str], configuration: Any) -> tuple[str, list[tuple[int, str]]]:
    """Return a sentence on tracker and subject, and the numbered works it cites."""
    given = f"`{run['input.name']}`"
    if run["tracker"] == "hand":
        kind, hand = configuration["filter"]["kind"], configuration["hand"]
        count = configuration["pso" if kind == "pso" else "filter"]["particles"]
        name, work = {
            "rbpf": ("a Rao-Blackwellized particle filter", 0),
            "pf": ("a particle filter", 0),
            "pso": ("a particle swarm optimiser", 1),
        }[kind]
        shape = "estimated from the recording" if configuration["init"]["shape"] == "auto" else "given"
        sentence = (
            f"The 22-dimensional pose of a {hand['side']} hand was estimated in depth images of {given} by "
            f"{name} with {count} particles [1]; size and shape of the hand were {shape}."
        )
        return sentence, [(1, HAND[work])]
    count = configuration["particles"]["count"]
    if run["tracker"] == "head-stereo":
        cameras = len(run["input.cameras"].split(",")) if "input.cameras" in run else "several"
        sentence = (
            f"Head pose and face deformation were estimated from {cameras} calibrated cameras of {given} by "
            f"a particle filter with {count} particles [1]; deformations were learned during tracking [2]."
        )
        return sentence, [(1, HEAD[0]), (2, HEAD[1])]
    lens = {
        "guessed": "a guessed focal length",
        "estimated": f"a focal length estimated as {run.get('focal_px')} ± {run.get('focal_sd_px')} pixels",
    }.get(run.get("intrinsics", ""), "a calibrated focal length")
    scale = {
        "prior": "from the average face",
        "interpupillary": "from the interpupillary distance",
        "person": "from an earlier recording of the person",
    }[run["scale"]]
    sentence = (
        f"Head pose and facial expression were estimated from one camera of {given}, with {lens}, "
        f"by a particle filter with {count} particles and a multilinear face model [1, 2]; "
        f"the scale is {scale}."
    )
    return sentence, [(1, HEAD[0]), (2, HEAD[2])]


def _frames(tracked: int, frames: int) -> str:
    share = f" ({tracked / frames:.1%})" if frames else ""
    lost = "; the others were reported as lost" if tracked < frames else ""
    return f"{tracked} of {frames} frames were tracked{share}{lost}."


def _software(run: Mapping[str, str]) -> str:
    return (
        f"Computed with posetrack {run['version']} (sources {run['sources']}), random seed {run['seed']}, "
        f"{run['libraries']}; SHA-256 of the input: {run.get('input.sha256') or 'not stored'}."
    )


def _command(run: Mapping[str, str], configuration: Any) -> Iterator[str]:
    """Yield the words of a command that gives the same estimates, with all settings that are not defaults."""
    yield from ("posetrack", *COMMANDS[run["tracker"]].split(), run["input.name"], "-o", "result.mcap")
    for key, option in OPTIONS.items():
        value = run.get(key, "")
        if value and value != DEFAULTS.get(key):
            yield from (option, value)
    if run.get("input.mirror") == "true":
        yield "--mirror"
    if run.get("intrinsics") == "guessed":
        yield from ("--fov", f"{guess_of_camera(camera_from_json(run['camera'])).fov_deg:.9g}")
    if run["tracker"] == "head-mono" and "input.topics" in run:
        yield from ("--cameras", run["input.topics"])
    usual = dict(flattened(_default(run["tracker"])))
    for key, value in flattened(configuration):
        if value is not None and value != usual.get(key):
            yield from ("--set", f"{key}={json.dumps(value)}")


def _default(tracker: str) -> Any:
    """Return the default configuration of a tracker, as it is recorded."""
    if tracker == "hand":
        from posetrack_cli.hand.config import HandConfig as Config
    elif tracker == "head-stereo":
        from posetrack_cli.head.config import HeadStereoConfig as Config  # type: ignore[assignment]
    else:
        from posetrack_cli.head.config import HeadMonoConfig as Config  # type: ignore[assignment]
    return Config().model_dump(mode="json")


def flattened(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yield keys such as ``filter.particles`` of nested tables, and their values."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from flattened(inner, f"{key}.{name}" if key else str(name))
    else:
        yield key, value
