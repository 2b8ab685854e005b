# SPDX-License-Identifier: Apache-2.0
"""Sessions, frames and the answers to them; units and frames as in geometry."""
from __future__ import annotations

import enum
import os
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Optional, Tuple, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._values import Array, Value
from .errors import GroundlockError
from .geometry import Box2, Box3, CameraModel, GeodeticPosition, Quaternion, RigidTransform
from .images import Image
from .inertial import ImuModel, InertialSamples

# --- sessions ----------------------------------------------------------------


class FlowMode(enum.Enum):
    """What happens when frames come faster than they are processed."""

    LOSSLESS = "lossless"  # the sender is held back
    LIVE = "live"  # the oldest waiting frame is dropped and answered so


@dataclass(frozen=True)
class SessionOptions:
    """What is left at its default is the server's choice."""

    localizer: str = ""  # "fast" or "baseline"
    tracker: str = ""  # "dcf", "act", "kcf", "csrt", ...
    flow_mode: Union[FlowMode, str] = FlowMode.LOSSLESS
    confidence_threshold: Optional[float] = None  # in (0, 1)
    target_lost_after_s: Optional[float] = None  # in (0, 86400]
    seed: int = 0  # same frames, options and seed: same results
    report_matches: bool = False  # landmarks seen, with each result
    report_movers: bool = False  # what moves by itself: FrameResult.movers
    # The unit that Frame.inertial comes from, or the path of its imu.json.
    imu: Union[ImuModel, str, "os.PathLike[str]", None] = None
    camera_lost_after_s: Optional[float] = None  # in [0, 86400]


class BodyKind(enum.Enum):
    """What a target's body is."""

    CAR = "car"
    VAN = "van"
    TRUCK = "truck"
    BUS = "bus"
    MOTORCYCLE = "motorcycle"
    BICYCLE = "bicycle"
    PERSON = "person"
    BOAT = "boat"


@dataclass(frozen=True, eq=False)
class TargetBody(Value):
    """What is known of a target's body. It makes the 3D box right from the first
    frame on; without a map it is of no use."""

    kind: Union[BodyKind, str, None] = None
    # Length, width and height, each good to 5 %, in metres or map units; None =
    # as its kind is. More than 0 and at most 500.
    size_m: Optional[ArrayLike] = None


@dataclass(frozen=True)
class SessionInfo:
    """A session as the server has it."""

    session_id: str
    map_name: str  # "" = none: targets in 2D only
    map_version: int
    camera: Optional[CameraModel]  # None: no map, and none was given
    options: SessionOptions
    create_time: datetime  # UTC
    next_sequence: int  # one past the last accepted frame
    frames_processed: int
    frames_dropped: int
    frames_failed: int
    target_ids: Tuple[str, ...]
    streaming: bool  # a client is attached
    owner: str = ""  # who has created it: Caller.name


@dataclass(frozen=True)
class Caller:
    """Who this client is for the server, and what it may do."""

    name: str  # of the token or certificate, or "jwt:" and the token's subject
    tenant: str  # whose maps and sessions there are; "" = of the one without a name
    scopes: Tuple[str, ...]  # "maps:read", "sessions:own", ..., implied ones included
    open_to_all: bool  # the server asks nobody: everybody may do everything


# --- frames ------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PosePrior(Value):
    """What other sensors say about where the camera is. Any part may be left
    out; a part goes with its standard deviation, per axis, above 0. It narrows
    the search while the camera is sought; a wrong one costs time alone."""

    # Of the camera's centre or, with position_arm_m, of the sensor; world.
    position_m: Optional[ArrayLike] = None
    position_sigma_m: Optional[float] = None
    # The same by GNSS, if the map has an origin; not together with position_m.
    geodetic_position: Optional[GeodeticPosition] = None
    geodetic_sigma_m: Optional[float] = None
    rotation: Optional[Quaternion] = None  # world_from_camera
    rotation_sigma_rad: Optional[float] = None
    # From the camera's centre to the sensor of the position (the antenna), along
    # the camera's axes: x right, y down, z forward. Goes with a position.
    position_arm_m: Optional[ArrayLike] = None


@dataclass(frozen=True, eq=False)
class Frame(Value):
    """A frame to send. `image`: whatever Image.of takes."""

    image: Any
    # None = one more than the previous. Strictly increasing; gaps are allowed.
    sequence: Optional[int] = None
    # A monotone clock, >= 0; None = this machine's, when it is sent.
    capture_time_ns: Optional[int] = None
    camera: Optional[CameraModel] = None  # of this frame alone
    prior: Optional[PosePrior] = None
    # Since the frame before, up to this one's capture time or a little beyond, at
    # most 4096: see InertialSamples.between. Of use with SessionOptions.imu.
    inertial: Optional[InertialSamples] = None


# --- answers -----------------------------------------------------------------


class CameraState(enum.Enum):
    INITIALIZING = "INITIALIZING"  # never localised yet, or not surely
    TRACKED = "TRACKED"  # the pose is verified in this frame
    # Where the map ends: carried on by what else is followed in the image; the
    # covariance grows with the way until the map is seen again.
    ODOMETRY = "ODOMETRY"
    HELD = "HELD"  # not verified: carried on from the last verified one
    LOST = "LOST"  # held for too long: no pose


class TargetState(enum.Enum):
    TRACKED = "TRACKED"  # seen in this frame
    PREDICTED = "PREDICTED"  # hidden, out of view or not believed
    LOST = "LOST"  # predicted for too long; still looked for


class DropReason(enum.Enum):
    UNKNOWN = "unknown"
    OVERLOAD = "overload"  # live mode: newer frames were waiting
    SHUTDOWN = "shutdown"  # the server is stopping


def _no_matches(columns: int) -> NDArray[np.float32]:
    return np.zeros((0, columns), dtype=np.float32)


@dataclass(frozen=True, eq=False)
class LensContradiction(Value):
    """By which the frames were taken with another lens than the session's."""

    focal_ratio: float  # the focal length seen over the given one; 1 = fits
    # How much farther out than the given distortion puts it the image's corner
    # is, as a share of its distance from the principal point; 0 = fits.
    corner_share: float


@dataclass(frozen=True, eq=False)
class CameraResult(Value):
    """Where the camera is."""

    state: CameraState
    world_from_camera: Optional[RigidTransform]  # None while there is no pose
    # 6x6, of the centre in world, m, and a rotation vector in world, rad:
    # R_true = Exp(dtheta) R. Set with the pose.
    covariance: Optional[Array]
    num_inliers: int  # in ODOMETRY not all in the map
    mean_reprojection_error_px: float
    reset_count: int  # raised whenever the pose does not continue the last one
    # Set once frames agree on it, and in each result from then on.
    lens_contradiction: Optional[LensContradiction] = None
    # The images contradict the gyroscope again and again, so it is not looked at
    # any more: its axes, clock or unit are other than was said.
    ignores_gyroscope: bool = False
    # If SessionOptions.report_matches: row i of both are of one landmark.
    match_xy_px: NDArray[np.float32] = field(default_factory=lambda: _no_matches(2))
    match_xyz_world: NDArray[np.float32] = field(default_factory=lambda: _no_matches(3))


@dataclass(frozen=True, eq=False)
class TargetResult(Value):
    """Where a target is."""

    target_id: str
    state: TargetState
    confidence: float  # of the 2D tracker, [0, 1]
    box: Optional[Box2]  # None if it does not project
    box_world: Optional[Box3]  # None without a camera pose, as the next ones
    ground_center_m: Optional[Array]  # world
    heading_rad: float  # about world z, 0 along x
    ground_covariance_m2: Optional[Array]  # 2x2, world x and y
    velocity_world_m_s: Optional[Array]
    age_s: float  # since it was last seen
    heading_sigma_rad: float = 0.0  # pi / sqrt(3) while nothing tells it
    front_known: bool = False  # if not, it may as well head the opposite way
    size_covariance_m2: Optional[Array] = None  # 3x3: length, width, height
    # What it is taken for, as was told or by its size; None: nothing.
    body_kind: Optional[BodyKind] = None


@dataclass(frozen=True)
class TargetError:
    """A target that could not be started in this frame, and why."""

    target_id: str
    message: str


class MoversState(enum.Enum):
    """Whether movers are looked for in a frame and, if not, why."""

    NOT_ASKED = "NOT_ASKED"  # SessionOptions.report_movers is off
    WATCHING = "WATCHING"  # movers are all that were found
    STARTING = "STARTING"  # too few frames so far
    NO_MAP = "NO_MAP"
    NO_GROUND = "NO_GROUND"  # the map does not know it, or the camera is below it
    NO_POSE = "NO_POSE"  # the camera is neither TRACKED nor in ODOMETRY
    # By so much of the picture that the pose is doubted.
    POSE_CONTRADICTED = "POSE_CONTRADICTED"


@dataclass(frozen=True, eq=False)
class Mover(Value):
    """What moves by itself over the ground: a suggestion for set_target."""

    mover_id: int  # stays with it from frame to frame
    box: Box2
    ground_center_m: Array  # world
    ground_covariance_m2: Optional[Array]  # 2x2, world x and y
    velocity_world_m_s: Array
    velocity_covariance_m2_s2: Optional[Array]  # 2x2, world x and y
    confidence: float  # the probability that it exists


@dataclass(frozen=True)
class StageTimes:
    """Wall clock, ms."""

    queue_ms: float
    decode_ms: float
    localize_ms: float
    track_ms: float
    total_ms: float
    movers_ms: float = 0.0


@dataclass(frozen=True)
class FrameResult:
    """The answer to a frame that was processed."""

    sequence: int
    capture_time_ns: int
    camera: CameraResult
    targets: Tuple[TargetResult, ...]
    map_version: int
    times: StageTimes
    target_errors: Tuple[TargetError, ...]
    movers: Tuple[Mover, ...] = ()  # the surest first; none unless WATCHING
    movers_state: MoversState = MoversState.NOT_ASKED

    def target(self, target_id: str) -> Optional[TargetResult]:
        """The target of that id, if it is followed."""
        return next((t for t in self.targets if t.target_id == target_id), None)


@dataclass(frozen=True)
class FrameFailed:
    """The answer to a frame that could not be processed; the session goes on."""

    sequence: int
    error: GroundlockError


@dataclass(frozen=True)
class FrameDropped:
    """The answer to a frame that was left out."""

    sequence: int
    reason: DropReason


# The one answer to a frame.
Answer = Union[FrameResult, FrameFailed, FrameDropped]


@dataclass(frozen=True)
class LocalizeReport:
    """Where a single image was taken; state TRACKED or LOST."""

    camera: CameraResult
    map_version: int
    times: StageTimes


@dataclass(frozen=True)
class WatchUpdate:
    """A result of a session that is watched."""

    result: FrameResult
    image: Optional[Image]
    skipped: int  # results left out since the last update
