# SPDX-License-Identifier: Apache-2.0
"""A whole video through the tracker, in one call."""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import (
    Any,
    Callable,
    Dict,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Set,
    Tuple,
)

import numpy as np

from . import tables
from ._channel import PathLike, TLS
from ._resume import StreamOptions
from ._values import identifier, integer, map_name
from .client import Client, Session
from .errors import InvalidArgumentError, bad_argument
from .geometry import Box2, CameraModel
from .images import Image, _module
from .inertial import ImuModel, InertialSamples
from .local_server import connect
from .results import (
    Answer,
    Frame,
    FrameDropped,
    FrameFailed,
    FrameResult,
    SessionInfo,
    SessionOptions,
    TargetResult,
)
from .video import Video, VideoFrame

# The id of the target that `box` marks, as `groundlock track --init-box` has it.
DEFAULT_TARGET = "target"

# Enough frames on the way to hide the wire.
_MAX_IN_FLIGHT = 8
_JPEG_QUALITY = 75


@dataclass(frozen=True)
class TrackRun:
    """What became of a video."""

    session: SessionInfo  # as it began
    answers: Tuple[Answer, ...]  # one for each frame, in order
    capture_times_ns: Dict[int, int]  # by sequence
    target_errors: Dict[str, str]  # targets that could not be started, and why
    num_reconnects: int

    @property
    def results(self) -> Tuple[FrameResult, ...]:
        """Of the frames that were processed."""
        return tuple(a for a in self.answers if isinstance(a, FrameResult))

    @property
    def failed(self) -> Tuple[FrameFailed, ...]:
        return tuple(a for a in self.answers if isinstance(a, FrameFailed))

    @property
    def dropped(self) -> Tuple[FrameDropped, ...]:
        return tuple(a for a in self.answers if isinstance(a, FrameDropped))

    def target(self, target_id: str = DEFAULT_TARGET) -> List[Tuple[int, TargetResult]]:
        """(sequence, result) of a target, in the frames that have it."""
        found = ((r.sequence, r.target(target_id)) for r in self.results)
        return [(sequence, t) for sequence, t in found if t is not None]

    def camera_path(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """(n, 3): the camera's centre in world, in the frames that have a pose."""
        poses = (r.camera.world_from_camera for r in self.results)
        centers = [p.translation for p in poses if p is not None]
        return np.array(centers).reshape(-1, 3)

    def to_frame(self) -> Any:
        """A pandas.DataFrame: see tables."""
        return tables.to_frame(self.answers, self.capture_times_ns)

    def write_csv(self, path: PathLike) -> int:
        """As `groundlock track --results` writes it; returns the rows."""
        return tables.write_csv(path, self.answers, self.capture_times_ns)


def track(
    video: PathLike,
    *,
    map: Optional[str],
    box: Any = None,
    box_frame: Optional[int] = None,
    body: Any = None,
    targets: Optional[Mapping[str, Any]] = None,
    camera: Any = None,
    imu: Any = None,
    inertial: Any = None,
    imu_epoch_ns: int = 0,
    options: Optional[SessionOptions] = None,
    first: int = 0,
    last: Optional[int] = None,
    fps: float = 25.0,
    on_answer: Optional[Callable[[Answer], Any]] = None,
    client: Optional[Client] = None,
    server: Optional[str] = None,
    local: bool = False,
    token: Optional[str] = None,
    tls: Optional[TLS] = None,
) -> TrackRun:
    """Tracks what `box` marks through a video, and returns all answers.

    video: a file, a folder of images (at `fps`), a URL or a V4L2 device.
    map: the map's name; None = in the image only.
    box: (x, y, width, height), px, in the frame `box_frame` (None = the first);
        the target's id is "target".
    body: what is known of that target, a TargetBody or its kind alone, as "car".
    targets: further ones: id to box, to (box, frame) or to (box, frame, body).
    camera: a CameraModel or the path of a camera.json; None = the lens that the
        map was made with.
    imu, inertial: the unit on the camera (an ImuModel or the path of an imu.json),
        and what it recorded (InertialSamples or the path of EuRoC's data.csv);
        imu_epoch_ns: what its clock says when the video's says 0.
    first, last: frames [first, last) of the video.
    on_answer: called with each answer as it comes; raising ends the run.
    client: the connection to use; without one, `server`, `local`, `token` and
        `tls` are those of connect().
    """
    wanted = _targets(box, box_frame, body, targets, first, last)
    if map is not None:
        map_name("map", map)
    elif options is not None and options.report_matches:
        raise bad_argument("options.report_matches", "needs a map")
    options, samples = _imu(imu, inertial, imu_epoch_ns, options)
    with Video(video, fps=fps, first=first, last=last) as source:
        own = client is None
        if client is None:
            client = connect(server, local=local, token=token, tls=tls)
        try:
            with client.create_session(
                map=map, camera=_lens(camera, source), options=options
            ) as session:
                for target_id, mark in wanted.items():
                    session.set_target(
                        target_id, mark.box, sequence=mark.frame, body=mark.body
                    )
                run = _Run(session, source, _is_near(client.server), on_answer, samples)
                return run.finish(session.info(), set(wanted))
        finally:
            if own:
                client.close()


class _Run:
    def __init__(
        self,
        session: Session,
        source: Video,
        raw: bool,
        on_answer: Optional[Callable[[Answer], Any]],
        inertial: Optional[InertialSamples],
    ) -> None:
        self._inertial = inertial
        self._session = session
        self._source = source
        self._raw = raw or _module("cv2") is None and _module("PIL.Image") is None
        self._on_answer = on_answer
        self._capture_times: Dict[int, int] = {}

    def _frames(self) -> Iterator[Frame]:
        previous_ns: Optional[int] = None
        for frame in self._source:
            time_ns = frame.capture_time_ns
            self._capture_times[frame.number] = time_ns
            samples = None
            if self._inertial is not None:
                samples = self._inertial.between(previous_ns, time_ns)
            yield Frame(self._image(frame), frame.number, time_ns, inertial=samples)
            previous_ns = time_ns

    def _image(self, frame: VideoFrame) -> Image:
        if isinstance(frame.image, bytes):
            return Image.file(frame.image)
        if self._raw:
            return Image.bgr(frame.image)
        return Image.jpeg(frame.image, quality=_JPEG_QUALITY)

    def finish(self, session: SessionInfo, wanted: Set[str]) -> TrackRun:
        answers: List[Answer] = []
        errors: Dict[str, str] = {}
        options = StreamOptions(max_in_flight=_MAX_IN_FLIGHT)
        with self._session.stream(options) as stream:
            for answer in stream.process(self._frames()):
                answers.append(answer)
                if isinstance(answer, FrameResult):
                    for error in answer.target_errors:
                        errors[error.target_id] = error.message
                if self._on_answer is not None:
                    self._on_answer(answer)
                # Nothing left to follow: the rest would be for nothing.
                if wanted and wanted <= set(errors):
                    name = sorted(wanted)[0]
                    raise InvalidArgumentError(
                        f"target {name}: {errors[name]}", field=f"targets[{name!r}]"
                    )
            reconnects = stream.num_reconnects
        if not answers:
            raise bad_argument("video", f"{self._source.source}: no frames in the range")
        first_failed = next((a for a in answers if isinstance(a, FrameFailed)), None)
        if first_failed is not None and all(isinstance(a, FrameFailed) for a in answers):
            raise first_failed.error
        return TrackRun(
            session, tuple(answers), self._capture_times, errors, reconnects
        )


class _Mark(NamedTuple):
    box: Box2
    frame: int
    body: Any


def _targets(
    box: Any,
    box_frame: Optional[int],
    body: Any,
    targets: Optional[Mapping[str, Any]],
    first: int,
    last: Optional[int],
) -> Dict[str, _Mark]:
    found: Dict[str, _Mark] = {}
    if box is not None:
        frame = first if box_frame is None else integer("box_frame", box_frame)
        found[DEFAULT_TARGET] = _Mark(Box2.of("box", box), frame, body)
    elif box_frame is not None:
        raise bad_argument("box_frame", "is the frame of `box`, which is missing")
    elif body is not None:
        raise bad_argument("body", "is that of what `box` marks, which is missing")
    for name, value in (targets or {}).items():
        field = f"targets[{name!r}]"
        identifier(field, name)
        if name in found:
            raise bad_argument(field, "is the name of the target that `box` marks")
        frame, told = first, None
        if isinstance(value, (tuple, list)) and len(value) in (2, 3):
            frame = integer(f"{field} frame", value[1])
            told = value[2] if len(value) == 3 else None
            value = value[0]
        found[name] = _Mark(Box2.of(field, value), frame, told)
    for name, mark in found.items():
        frame = mark.frame
        if frame < first or (last is not None and frame >= last):
            raise bad_argument(
                "box_frame" if name == DEFAULT_TARGET else f"targets[{name!r}]",
                f"frame {frame} is not among the frames [{first}, {last or 'end'})",
            )
    return found


def _imu(
    imu: Any, inertial: Any, epoch_ns: int, options: Optional[SessionOptions]
) -> Tuple[Optional[SessionOptions], Optional[InertialSamples]]:
    if imu is None and inertial is None:
        return options, None
    if imu is None or inertial is None:
        missing, given = ("imu", "inertial") if imu is None else ("inertial", "imu")
        raise bad_argument(missing, f"is missing: {given} needs it")
    options = replace(options or SessionOptions(), imu=ImuModel.of("imu", imu))
    epoch_ns = integer("imu_epoch_ns", epoch_ns, -(1 << 62), 1 << 62)
    return options, InertialSamples.of("inertial", inertial).since(epoch_ns)


def _lens(camera: Any, source: Video) -> Optional[CameraModel]:
    if camera is None:
        return None
    size = (source.width_px, source.height_px)
    lens = CameraModel.of("camera", camera)
    if (lens.width_px, lens.height_px) != size:
        raise bad_argument(
            "camera",
            f"is for {lens.width_px}x{lens.height_px}, but frames of "
            f"{source.source} are {size[0]}x{size[1]}",
        )
    return lens


def _is_near(server: str) -> bool:
    """On this machine: frames go as they are; else as JPEG."""
    host = server.rpartition(":")[0]
    return host.startswith(("127.", "[::1]", "unix:")) or host == "localhost"
