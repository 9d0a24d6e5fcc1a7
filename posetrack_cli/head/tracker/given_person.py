"""The person of an earlier result, as identity, size and templates for a run with one camera.

A one-camera result contains all of them. Several cameras measured the face: its mean shape F (K, 3), mm, in
true size, is kept. The identity, which determines the deformation, is the most likely one for that shape,

    u = argmin |(R F' + t - M(u)) / D|^2 + prior |u|^2,    F' = F + d

with M(u) the model's mean deformation, d its difference from the neutral face (``head.actions``) and D the
standard deviations of offsets; R, t align F' with the mean person. Offsets then reproduce F'. **[ours]**
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
"""Of the logarithm of a size measured by several cameras: calibrations are accurate to a few per mille."""
LEAST_PRIOR = 1e-6
"""Keeps the identity of a shape determined when the prior is switched off."""
STEREO = "head-stereo"


@dataclass(frozen=True, eq=False)
class GivenPerson:
    """A person learned in an earlier run.

    Attributes:
        learned: exported arrays of a tracker that knows only this person.
        size: size of the person; None if unknown.
        is_measured: whether several cameras measured the person.
    """

    learned: Learned
    size: Size | None
    is_measured: bool = False

    @property
    def systematic_sd(self) -> FloatArray:
        """(6,) systematic error of a track, due to the earlier run's placement of the head's frame."""
        return (STEREO_TRACK if self.is_measured else MONO_TRACK).systematic_sd


def read_person(path: Path, model: FaceModel, settings: AdjustmentSettings) -> GivenPerson:
    """Read the first person of a result, to be kept fixed.

    Args:
        path: a result of ``posetrack head``, or a file from ``--save-model`` with one camera.
        model: face model; for a one-camera result it must be the one of that run.
        settings: of the adjustment.

    Raises:
        UsageError: the file does not exist, or does not contain a camera.
        ResultError: not such a file, damaged, or made with another face model.
    """
    header, learned = read_model(path)
    people = people_codec(model, settings)
    try:
        if header["tracker"] == STEREO:
            cameras = len(header["cameras"])
            state = StereoCodecs(cameras, ModelSettings()).from_model(learned)
            person, focal = _person_from_stereo(state, model, settings), np.array(_focal_px(path))
        else:
            (person, *_), focal = known_people(learned, people), _focal_of(learned)
    except ResultError as error:
        raise ResultError(str(error), where=path) from error
    # views and album belong to the images of that run
    held = replace(person, views=(), album=Album(), is_settled=True, is_held=True)
    is_measured = header["tracker"] == STEREO
    return GivenPerson(people.to_arrays((held,)) | {FOCAL_PX: focal}, held.size, is_measured)


def _focal_of(learned: Arrays) -> FloatArray:
    if FOCAL_PX not in learned:
        raise ResultError("model is incomplete or damaged", found=f"array '{FOCAL_PX}' is missing")
    return learned[FOCAL_PX]


def _focal_px(path: Path) -> float:
    """Return the focal length of the reference camera of a stereo result."""
    if is_mcap(path):
        return read_result(path).camera().fx
    raise UsageError(
        "a model file of several cameras does not contain their intrinsics",
        where=path,
        expected="the result of that run",
    )


def _person_from_stereo(state: StereoState, model: FaceModel, settings: AdjustmentSettings) -> KnownPerson:
    """Return the person measured by several cameras, with the reference camera's templates."""
    person, size = person_from_shape(state.known_face.model.mean, model, settings), Size(1.0, STEREO_SIZE_SD)
    history = IdentityHistory.starting_with(person.identity, settings.average)
    seen = tuple(_reference_camera_only(one) for one in state.templates)
    return KnownPerson(person, history, (), Album(), person_shape(model, person, size), seen, size=size)


def person_from_shape(shape: FloatArray, model: FaceModel, settings: AdjustmentSettings) -> PersonParameters:
    """Fit the person whose neutral face is a shape (K, 3), mm."""
    deformed, usual = shape + MEAN_DISPLACEMENTS, model.of_person(model.identity_mean).mean
    R, t = rigid_alignment(deformed, usual, 1.0 / np.square(OFFSET_SD_MM).mean(axis=1))
    basis = np.einsum("kisa,a->kis", model.core, model.deformation_mean) * model.identity_deviations
    A = (basis / OFFSET_SD_MM[..., None]).reshape(-1, model.identity_size)
    b = ((deformed @ R.T + t - usual) / OFFSET_SD_MM).ravel()
    precision = A.T @ A + max(settings.prior, LEAST_PRIOR) * np.eye(A.shape[1])
    u = np.linalg.solve(precision, A.T @ b)
    identity = model.identity_mean + np.clip(u, -settings.bound, settings.bound) * model.identity_deviations
    return PersonParameters(identity, deformed - model.of_person(identity).mean)


def _reference_camera_only(templates: TemplateSet) -> TemplateSet:
    """Return the templates of the first camera."""
    each = ("windows", "centres", "tangents", "seen")
    return replace(templates, **{name: getattr(templates, name)[:1] for name in each})
