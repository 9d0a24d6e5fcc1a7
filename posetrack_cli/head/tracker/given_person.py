"""The person of another result, for a run with one camera: who it is, how large, and what it looks like.

A result of one camera says all of it. Two cameras or more measured the face: its mean shape F (K, 3), mm, in
true size, is taken as it is. The identity is the likeliest of such a shape, for how the face deforms,

    u = argmin |(R F' + t - M(u)) / D|^2 + prior |u|^2,    F' = F + d

with M(u) the model's mean deformation, d how far that is from the neutral face (``head.actions``) and D the
deviations of offsets; R, t lie F' on the mean person. Offsets then make the shape F'. **[ours]**
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.geometry.rigid import rigid_alignment
from posetrack_cli.head.actions import MEAN_DISPLACEMENTS
from posetrack_cli.head.adjustment.adjuster import OFFSET_SD_MM, Album, PersonParameters
from posetrack_cli.head.config import AdjustmentSettings, ModelSettings
from posetrack_cli.head.face.templates import TemplateSet
from posetrack_cli.head.model_file import read_model
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.subject import MONO_TRACK, STEREO_TRACK
from posetrack_cli.head.tracker.codecs import FOCAL_PX, known_people, people_codec
from posetrack_cli.head.tracker.person import IdentityHistory, KnownPerson, Size, person_shape
from posetrack_cli.head.tracker.stereo import StereoCodecs, StereoState
from posetrack_cli.mcap.stream import is_mcap
from posetrack_cli.results.columns import Arrays
from posetrack_cli.results.reader import read_result
from posetrack_cli.tracking.two_pass import Learned

STEREO_SIZE_SD = 0.005
"""Of the logarithm of what several cameras measure: boards and calibrations are right to some tenths of a per
cent."""
LEAST_PRIOR = 1e-6
"""Without any the identity of a shape might be anything."""
STEREO = "head-stereo"


@dataclass(frozen=True, eq=False)
class GivenPerson:
    """A person whom another run has learned.

    Attributes:
        learned: for a tracker to begin with, as one that knows this person alone exports it.
        size: how large the person is; None where that run did not know.
        is_measured: whether several cameras measured the person.
    """

    learned: Learned
    size: Size | None
    is_measured: bool = False

    @property
    def systematic_sd(self) -> FloatArray:
        """(6,) what a track of the person is wrong by: the head's frame sits where that run laid it."""
        return (STEREO_TRACK if self.is_measured else MONO_TRACK).systematic_sd


def read_person(path: Path, model: FaceModel, settings: AdjustmentSettings) -> GivenPerson:
    """Read the first person of a result, whom the tracker then holds.

    Args:
        path: a result of ``posetrack head``, or what ``--save-model`` of one camera wrote.
        model: of faces, the one that a result of one camera was made with.
        settings: of the adjustment.

    Raises:
        UsageError: there is no such file, or it says nothing of a camera.
        ResultError: it is no such file, damaged, or of another face model.
    """
    header, learned = read_model(path)
    people = people_codec(model, settings)
    try:
        if header["tracker"] == STEREO:
            cameras = len(header["cameras"])
            state = StereoCodecs(cameras, ModelSettings()).from_model(learned)
            person, focal = _measured(state, model, settings), np.array(_focal_px(path))
        else:
            (person, *_), focal = known_people(learned, people), _focal_of(learned)
    except ResultError as error:
        raise ResultError(str(error), where=path) from error
    held = replace(person, views=(), album=Album(), is_settled=True, is_held=True)
    is_measured = header["tracker"] == STEREO
    return GivenPerson(people.to_arrays((held,)) | {FOCAL_PX: focal}, held.size, is_measured)


def _focal_of(learned: Arrays) -> FloatArray:
    if FOCAL_PX not in learned:
        raise ResultError("model is incomplete or damaged", found=f"no array '{FOCAL_PX}'")
    return learned[FOCAL_PX]


def _focal_px(path: Path) -> float:
    """The focal length with which several cameras' reference saw the face."""
    if is_mcap(path):
        return read_result(path).camera().fx
    raise UsageError(
        "a model of several cameras does not say what their images were like",
        where=path,
        expected="the result of that run",
    )


def _measured(state: StereoState, model: FaceModel, settings: AdjustmentSettings) -> KnownPerson:
    """The face that several cameras measured, with what it looked like to the reference."""
    person, size = person_like(state.known_face.model.mean, model, settings), Size(1.0, STEREO_SIZE_SD)
    history = IdentityHistory.starting_with(person.identity, settings.average)
    seen = tuple(_of_reference(one) for one in state.templates)
    return KnownPerson(person, history, (), Album(), person_shape(model, person, size), seen, size=size)


def person_like(shape: FloatArray, model: FaceModel, settings: AdjustmentSettings) -> PersonParameters:
    """Return the person whose neutral face is a shape (K, 3), mm."""
    deformed, usual = shape + MEAN_DISPLACEMENTS, model.of_person(model.identity_mean).mean
    R, t = rigid_alignment(deformed, usual, 1.0 / np.square(OFFSET_SD_MM).mean(axis=1))
    basis = np.einsum("kisa,a->kis", model.core, model.deformation_mean) * model.identity_deviations
    A = (basis / OFFSET_SD_MM[..., None]).reshape(-1, model.identity_size)
    b = ((deformed @ R.T + t - usual) / OFFSET_SD_MM).ravel()
    precision = A.T @ A + max(settings.prior, LEAST_PRIOR) * np.eye(A.shape[1])
    u = np.linalg.solve(precision, A.T @ b)
    identity = model.identity_mean + np.clip(u, -settings.bound, settings.bound) * model.identity_deviations
    return PersonParameters(identity, deformed - model.of_person(identity).mean)


def _of_reference(templates: TemplateSet) -> TemplateSet:
    """What one camera of several saw."""
    each = ("windows", "centres", "tangents", "seen")
    return replace(templates, **{name: getattr(templates, name)[:1] for name in each})
