"""The synthetic persons: recordings, stereo results, models built from these, and one-camera results."""

from __future__ import annotations

from collections.abc import Iterable

from reproduction.one_camera.entrants import POPULATION, Entrant
from reproduction.one_camera.options import Options
from reproduction.steps import FILE, Chain, Step

RECORDED, MODELLED, TRACKED = range(3)
"""Stages."""
MOTIONS_SEED = 1000
"""Added to a person's seed: what happens in the recordings of one person has nothing in common."""
CAMERA = "left"
"""The one that is used alone."""


def chains(options: Options) -> list[Chain]:
    """Everything that the experiments need of the synthetic persons."""
    return [
        *(recorded(_motions_name(options, person), _motions(options, person)) for person in options.modelled),
        *(recorded(test_name(options, person), _test(options, person)) for person in options.persons),
        *_models(options),
        *(_tracked(options, person) for person in options.persons),
    ]


def test_recording(options: Options, person: int) -> str:
    """Of a person, natural motion and all expressions; both cameras."""
    return f"recordings/{test_name(options, person)}.mcap"


def stereo_result(options: Options, person: int) -> str:
    """The second pass of the stereo tracker: the thesis's reference."""
    return _stereo(test_name(options, person))


def mono_result(options: Options, person: int, entrant: str) -> str:
    """Of the left camera alone."""
    return f"runs/{test_name(options, person)}-{entrant}.mcap"


def test_name(options: Options, person: int) -> str:
    """What the files of a person's test are called by."""
    return f"test-{person}-{options.frames}"


def model_of(options: Options, without: int | None = None) -> str:
    """The model of all persons, or of all but one."""
    first, last = options.modelled[0], options.modelled[-1]
    left_out = "" if without is None else f"-without-{without}"
    return f"models/face-{first}-{last}{left_out}.npz"


def _motions_name(options: Options, person: int) -> str:
    return f"motions-{person}-{options.motion_frames}"


def _motions(options: Options, person: int) -> tuple[str, ...]:
    """Arguments that make a recording of the two motions."""
    happens = ("--script", "two-motions", "--motion", "slight")
    seed = ("--seed", str(MOTIONS_SEED + person))
    return ("--identity", str(person), *seed, "--frames", str(options.motion_frames), *happens)


def _test(options: Options, person: int) -> tuple[str, ...]:
    return ("--identity", str(person), "--seed", str(person), "--frames", str(options.frames))


def recorded(name: str, arguments: tuple[str, ...]) -> Chain:
    """A synthetic recording, and the stereo tracker's second pass over it."""
    recording = f"recordings/{name}.mcap"
    drawn = Step(recording, ("head", "synth", *arguments))
    return Chain(
        name,
        RECORDED,
        (drawn, Step(_stereo(name), ("head", "stereo", f"{FILE}{recording}", "--passes", "2"))),
    )


def _stereo(name: str) -> str:
    return f"runs/{name}-stereo.mcap"


def _models(options: Options) -> Iterable[Chain]:
    """The model of all, and those without each test person."""
    for without in (None, *options.persons):
        results = (
            f"{FILE}{_stereo(_motions_name(options, person))}"
            for person in options.modelled
            if person != without
        )
        output = model_of(options, without)
        yield Chain(output, MODELLED, (Step(output, ("head", "build-model", *results)),))


def _tracked(options: Options, person: int) -> Chain:
    steps = (_mono(options, person, entrant) for entrant in POPULATION)
    return Chain(f"{test_name(options, person)}, one camera", TRACKED, tuple(steps))


def _mono(options: Options, person: int, entrant: Entrant) -> Step:
    recording = f"{FILE}{test_recording(options, person)}"
    left_out = None if entrant.model == "all" else person
    model = model_of(options, left_out)
    face = () if entrant.model == "shipped" else ("--face-model", f"{FILE}{model}")
    arguments = ("head", "mono", recording, "--cameras", CAMERA, *face, *entrant.arguments, "--timings")
    return Step(mono_result(options, person, entrant.name), arguments)
