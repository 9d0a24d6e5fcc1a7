"""Several-camera part of the head tracker: detects, recognises and learns one face (chapter 3)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rigid import rigid_alignment
from posetrack_cli.geometry.rotations import quaternions_from_matrices
from posetrack_cli.head.adjustment.adjuster import PointView
from posetrack_cli.head.config import HeadStereoConfig, ModelSettings
from posetrack_cli.head.face.points import POINT_COUNT, HeadPose, rigid_model
from posetrack_cli.head.face.templates import CAMERAS, TemplateSet, is_new_direction, take_templates
from posetrack_cli.head.initialisation.clicked import ClickedInitialiser, ClickedPoints
from posetrack_cli.head.initialisation.search import InitFailure
from posetrack_cli.head.initialisation.stereo import StereoInitialisation, StereoInitialiser
from posetrack_cli.head.landmarks.faces import LandmarkFile, Landmarks
from posetrack_cli.head.model_file import damaged_model
from posetrack_cli.head.refinement.refine import (
    KEYFRAME_CORRELATION,
    KEYFRAME_NEUTRAL_MM,
    refine_initial_depth,
)
from posetrack_cli.head.skin.map import SkinMap, cut_view, make_map, pose_on_map
from posetrack_cli.head.skin.matching import MOST_VIEWS, SkinAlbum
from posetrack_cli.head.subject import STEREO_TRACK, StereoDiagnostics, stereo_diagnostic_names
from posetrack_cli.head.tracker.codecs import map_codec, search_codec, skin_codec
from posetrack_cli.head.tracker.face_learning import Ccipca, FaceLearning, new_face
from posetrack_cli.head.tracker.frame_tracker import (
    STEREO,
    FrameFit,
    FrameTracker,
    HeadState,
    SeededFrame,
    TrackState,
    initial_fit,
)
from posetrack_cli.head.tracker.head_tracker import FaceDescription, HeadTracker, dense_faces, padded
from posetrack_cli.head.tracker.whole_face import whole_face_fit
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.columns import Arrays, LayoutError, counts, floats
from posetrack_cli.tracking.confidence import Regression
from posetrack_cli.tracking.state_codec import (
    Array,
    Codec,
    Fields,
    Maybe,
    Stacked,
    Value,
    codec_of,
    parts_of,
    real,
)
from posetrack_cli.tracking.two_pass import Learned


@dataclass(frozen=True, eq=False)
class StereoState(HeadState):
    """State of a stereo tracker after a frame.

    Attributes:
        face: the learned face; None before the first detection.
        templates: reference first; empty before the first detection.
        skin: frames of the first of two passes for the skin map of the second.
        skin_map: from the first pass; None during it.
    """

    face: FaceLearning | None = None
    templates: tuple[TemplateSet, ...] = ()
    skin: SkinAlbum = field(default_factory=SkinAlbum)
    skin_map: SkinMap | None = None

    @property
    def known_face(self) -> FaceLearning:
        """The learned face of a head that was found."""
        if self.face is None:
            raise RuntimeError("no face is known yet")
        return self.face


class StereoFace:
    """One face in the images of calibrated cameras; implements ``Faces``.

    Args:
        config: of the run.
        cameras: of the recording, the reference first.
        initialiser: finds a face in one frame.
        known: exported model and templates to start from.

    Raises:
        ResultError: ``known`` was not exported by a stereo tracker with these cameras.
    """

    def __init__(
        self,
        config: HeadStereoConfig,
        cameras: Sequence[Camera],
        initialiser: StereoInitialiser,
        known: Arrays | None = None,
    ) -> None:
        self._config, self._initialiser = config, initialiser
        self.cameras, self.status = tuple(cameras), config.status
        self._frame_tracker = FrameTracker(config, self.cameras)
        self._steadiness = config.model.expression_mm.values**-2
        self._codecs = StereoCodecs(len(self.cameras), config.model)
        self._first = StereoState() if known is None else self._codecs.from_model(known)

    @property
    def codec(self) -> Codec[StereoState]:
        """Conversion of states to arrays and back."""
        return self._codecs.state

    def start(self) -> StereoState:
        """Return the state before the first frame."""
        return self._first

    def prepare(self, state: StereoState, frame: Frame) -> tuple[StereoState, Frame]:
        """Return both unchanged: images are not scaled."""
        return state, frame

    def is_known(self, state: StereoState) -> bool:
        """Whether the face has been learned."""
        return state.face is not None

    def person_index(self, state: StereoState) -> int:
        """Return 0: templates belong to one person."""
        return 0

    def detect(self, state: StereoState, frame: SeededFrame) -> StereoInitialisation | InitFailure:
        """Detect a face in a frame."""
        is_first, is_known = frame.stamp_ns == state.first_ns, self.is_known(state)
        return self._initialiser.find(frame.frame, is_first=is_first, is_known=is_known)

    def begin(self, state: StereoState, frame: SeededFrame) -> tuple[StereoState, FrameFit | InitFailure]:
        """Detect a face and start to learn it."""
        found = self.detect(state, frame)
        if isinstance(found, InitFailure):
            return state, found
        images = self._frame_tracker.images(frame)
        shape = refine_initial_depth(images, found.pose, found.shape, self._config.refinement)
        face = new_face(shape, self._config.model)
        reference = take_templates(images, found.pose, shape)
        track = self._frame_tracker.start(frame, found.pose, shape, face.model, reference)
        search = replace(state.search, order=(), swapped=0)
        state = replace(state, face=face, templates=(reference,), track=track, lost=0, search=search)
        return state, initial_fit(track, found.score, found.pixels)

    def fit(self, state: StereoState, track: TrackState, frame: SeededFrame) -> tuple[StereoState, FrameFit]:
        """Track the head into a frame; restart from landmarks if the points slid **[ours]**."""

        def refit(about: TrackState, templates: Sequence[TemplateSet] | None) -> FrameFit:
            return self._frame_tracker.step(
                about, frame, templates or state.templates, state.known_face.model
            )

        images, clear = self._frame_tracker.images(frame), self._config.status.check_below
        fit = whole_face_fit(refit(track, None), track, images, refit, clear=clear, trust=state.trust)
        landmarks = self._initialiser.from_landmarks(frame.frame, fit.pixels[0])
        if landmarks is None:
            return state, fit
        again = self._from_points(state, landmarks, frame, track.stamp_ns)
        # landmarks only propose a pose: the images decide
        return state, again if again.score > fit.score else fit

    def recognise(
        self, state: StereoState, found: StereoInitialisation, frame: SeededFrame
    ) -> Iterator[tuple[StereoState, FrameFit]]:
        """Align the known face with the detected points, and track it from there."""
        yield state, self._from_points(state, found, frame, state.last_seen_ns(frame))

    def least_score(self, state: StereoState) -> float:
        """Return the minimum score for the known face."""
        return self._config.status.tracking_above

    def not_recognised(self, state: StereoState, found: StereoInitialisation) -> tuple[StereoState, bool]:
        """Return False: templates belong to one person, so no new face is started."""
        return state, False

    def learn(self, state: StereoState, frame: SeededFrame, fit: FrameFit) -> tuple[StereoState, FrameFit]:
        """Learn the deformation, and templates from new directions."""
        state = replace(state, trust=min(fit.score, 1.0))
        if fit.is_anchored:  # no templates matched, so the frame shows nothing new of the face
            return state, fit
        now, templates = fit.track, state.templates
        expected = state.known_face.model.shapes(fit.coefficients)
        face = state.known_face.after(now.shape, self._steadiness, now.pose, fit.correlations, expected)
        if now.templates is not None and self._is_keyframe(templates, fit):
            templates = (*templates, _keyframe(now.templates, fit))
        return self._keep_skin(replace(state, face=face, templates=templates), frame, fit), fit

    def _keep_skin(self, state: StereoState, frame: SeededFrame, fit: FrameFit) -> StereoState:
        """Return the state with a frame's skin if another pass follows **[ours]**."""
        images = [image for image in frame.frame.images if image is not None]
        is_used = self._config.skin.use and self._config.run.passes > 1 and state.skin_map is None
        is_whole = len(images) == len(self.cameras)
        if not (is_used and is_whole and state.skin.wants(frame.stamp_ns, fit.track.pose)):
            return state
        view = PointView(frame.stamp_ns, fit.pixels[0], fit.weights, fit.track.pose, np.zeros(0))
        shown = cut_view(images, self.cameras, view)
        return replace(state, skin=state.skin.with_view(shown, MOST_VIEWS // len(self.cameras)))

    def report_fit(
        self, state: StereoState, frame: SeededFrame, fit: FrameFit
    ) -> tuple[StereoState, FrameFit]:
        """Return the fit for the result, in a second pass with a pose between points and skin **[ours]**.

        The points stay where they are.
        """
        if state.skin_map is None:
            return state, fit
        now, images = fit.track, frame.frame.images
        found = pose_on_map(state.skin_map, images, frame.stamp_ns, now.pose, self.cameras)
        shape = (now.pose.points(now.shape) - found.pose.position) @ found.pose.rotation
        now = replace(now, pose=found.pose, shape=shape)
        return state, replace(fit, track=now, unmatched=found.unmatched, skin_share=found.share)

    def regression(self, reported: FrameFit) -> Regression:
        """Return the confidence model for a frame."""
        return STEREO

    def describe(self, state: StereoState, fit: FrameFit | None) -> FaceDescription:
        """Return deformation and diagnostics of a frame."""
        count, face = components_of(self._config), state.face
        nothing = np.zeros(0)
        return FaceDescription(
            padded(nothing if fit is None else fit.coefficients, count),
            padded(nothing if face is None else face.model.deviations, count),
            _diagnostics(face, fit).numbers(count),
            None if face is None or fit is None else self._systematic_variance(face, fit),
        )

    def _systematic_variance(self, face: FaceLearning, fit: FrameFit) -> FloatArray:
        """Return the (6,) variances of the systematic error, which grow while the brows are raised."""
        variance = np.square(STEREO_TRACK.systematic_sd)
        if not self._config.face.use:  # the papers state no error of expressions
            return variance
        return variance + STEREO_TRACK.expression_variance(fit.track.shape - face.model.mean)

    def export_model(self, state: StereoState, *, for_second_pass: bool) -> Learned:
        """Return the learned shape model and templates, for a second pass with the map of the skin."""
        views, mean = state.skin.views if for_second_pass else (), state.known_face.model.mean
        return self._codecs.to_model(replace(state, skin_map=make_map(views, mean, self.cameras)))

    def remarks(self, state: StereoState) -> tuple[str, ...]:
        """Return nothing: a head that was found as recorded confirms the order of the cameras."""
        return ()

    def _is_keyframe(self, templates: Sequence[TemplateSet], fit: FrameFit) -> bool:
        """Whether a nearly neutral face is seen from a direction without templates."""
        neutral = float(np.linalg.norm(fit.coefficients)) < KEYFRAME_NEUTRAL_MM
        clear = fit.score > KEYFRAME_CORRELATION
        apart_deg = self._config.refinement.keyframe_deg
        return neutral and clear and is_new_direction(templates, fit.track.pose.facing, apart_deg)

    def _from_points(
        self, state: StereoState, found: StereoInitialisation, frame: SeededFrame, last_ns: int
    ) -> FrameFit:
        """Track the known face from detected points; the fit has no velocity."""
        model = state.known_face.model
        pose = self._aligned_pose(model.mean, found)
        track = replace(self._frame_tracker.start(frame, pose, model.mean, model), stamp_ns=last_ns)
        fit = self._frame_tracker.step(track, frame, state.templates, model)
        return replace(fit, track=fit.track.at_rest())

    def _aligned_pose(self, mean: FloatArray, found: StereoInitialisation) -> HeadPose:
        """Return the pose that aligns the known shape with detected points."""
        R, t = rigid_alignment(mean, found.pose.points(found.shape), self._steadiness)
        return HeadPose(t, quaternions_from_matrices(R))


def make_stereo_tracker(
    config: HeadStereoConfig,
    cameras: Sequence[Camera],
    known: Arrays | None = None,
    *,
    clicked: Path | None = None,
    landmarks: LandmarkFile | None = None,
) -> StereoTracker:
    """Create the tracker of a run.

    Args:
        config: of the run.
        cameras: of the recording, the reference first.
        known: arrays exported by another tracker.
        clicked: table of points in the first frame; without it the face is detected there as well.
        landmarks: of the reference camera's images, from another program.

    Raises:
        UsageError: a face detector without its model, or a missing table.
        PosetrackError: invalid clicked points.
        ResultError: ``known`` was not exported by such a tracker.
    """
    settings = config.start
    faces = None if landmarks is None else Landmarks(landmarks, cameras[0])
    if clicked is None:
        initialiser = StereoInitialiser(settings, cameras, faces)
    else:
        points = ClickedPoints.read(clicked, cameras)
        initialiser = ClickedInitialiser(settings, cameras, points, faces)
    dense = dense_faces(config, cameras, stereo_diagnostic_names(components_of(config)), known)
    return HeadTracker(StereoFace(config, cameras, initialiser, known), dense, known)


StereoTracker: TypeAlias = HeadTracker[StereoState, StereoInitialisation]


def components_of(config: HeadStereoConfig) -> int:
    """Return B, the number of deformation coefficients in the result."""
    return 0 if config.model.kind == "rigid" else config.model.components


def _keyframe(templates: TemplateSet, fit: FrameFit) -> TemplateSet:
    """Return a frame's templates without points that a camera does not see, or sees covered."""
    if fit.by_camera is None:
        return templates
    alike = np.nan_to_num(fit.by_camera) > KEYFRAME_CORRELATION
    return replace(templates, seen=templates.seen & alike)


def _diagnostics(face: FaceLearning | None, fit: FrameFit | None) -> StereoDiagnostics:
    score, weights = (np.nan, None) if fit is None else (fit.score, fit.weights)
    moved = None if face is None or fit is None else fit.track.shape - face.model.mean
    if face is None or face.statistics.learnt == 0:
        return StereoDiagnostics(np.zeros(0), score=score, weights=weights, moved=moved)
    statistics = face.statistics
    ratio = float(statistics.contribution[-1])
    return StereoDiagnostics(statistics.eigenvalues, ratio, statistics.learnt, score, weights, moved)


class StereoCodecs:
    """Conversion of a stereo tracker's states, and of learned faces, to arrays and back.

    Args:
        cameras: number of cameras.
        settings: of the face model.
    """

    def __init__(self, cameras: int, settings: ModelSettings) -> None:
        def face(
            mean: Array, components: Array, variance: float, counts: Array, found: Array | None = None
        ) -> FaceLearning:
            count, learnt, frames = (int(value) for value in counts)
            statistics = Ccipca(mean, components, variance, count, learnt)
            rigid = statistics.rigid if found is None else rigid_model(found)
            is_printed = settings.rigid_phase == "printed"
            return FaceLearning(statistics, frames, settings, rigid if is_printed else None)

        points: Value[FloatArray] = Value(floats(POINT_COUNT, 3))
        faces: Codec[FaceLearning] = Fields(
            face,
            found=(lambda one: None if one.found is None else one.found.mean, Maybe(points)),
            mean=("statistics.mean", points),
            components=("statistics.components", Value(floats("components", 3 * POINT_COUNT))),
            variance=("statistics.variance", real(floats(least=0.0))),
            counts=(
                lambda one: [one.statistics.count, one.statistics.learnt, one.frames],
                Value(counts(3)),
            ),
        )
        templates = codec_of(TemplateSet, {CAMERAS: cameras})
        needed = Stacked(templates, "sets", least=1)
        skin_map = Maybe(map_codec(cameras))
        self._known: Codec[StereoState] = Fields(
            _state, face=faces, sets=("templates", needed), skin_map=skin_map
        )
        learned: dict[str, Any] = {
            "search": search_codec(cameras),
            "skin_map": skin_map,
            "face": Maybe(faces),
            "sets": ("templates", Stacked(templates, "sets")),
        }
        self._model: Codec[StereoState] = Fields(_state, **learned)
        own = parts_of(HeadState, {CAMERAS: cameras}, search=learned["search"])
        own["skin"] = skin_codec(cameras, 0)
        self.state: Codec[StereoState] = Fields(_state, **(learned | own))

    def to_model(self, state: StereoState) -> Learned:
        """Return the arrays of a model file: face, templates, search statistics and a map of the skin."""
        return self._model.to_arrays(state)

    def from_model(self, learned: Mapping[str, Array]) -> StereoState:
        """Return the state that starts with an exported face and templates.

        Raises:
            ResultError: arrays are missing, or not from a stereo tracker with this number of cameras.
        """
        try:
            return self._known.from_arrays(learned)
        except LayoutError as error:
            raise damaged_model(error, "a model saved by a stereo run") from error


def _state(sets: tuple[TemplateSet, ...], **parts: Any) -> StereoState:
    """Build a state; a tracked head requires a face, and a face its templates."""
    state = StereoState(templates=sets, **parts)
    known = (state.face is not None, bool(state.templates))
    if known != (True, True) and (any(known) or state.track is not None):
        raise LayoutError("a tracked head without face or templates")
    return state
