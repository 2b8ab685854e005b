# SPDX-License-Identifier: Apache-2.0
"""Between the messages and the dataclasses. What goes out is checked; errors
name the field."""
from __future__ import annotations

import json
from datetime import datetime, timezone
from typing import Any, Dict, Optional, Tuple, TypeVar, Union

import numpy as np

from . import maps as m
from . import results as r
from ._values import (
    above_zero,
    choice,
    frozen,
    integer,
    number,
    vector,
)
from .errors import InternalError, bad_argument, error_of
from .geometry import (
    Box2,
    Box3,
    CAMERA_MODELS,
    CameraModel,
    GeodeticPosition,
    Plane,
    Quaternion,
    RigidTransform,
    SimilarityTransform,
)
from .images import Encoding, Image
from .inertial import ImuModel, InertialSamples, MAX_SAMPLES_PER_FRAME
from .v1 import geometry_pb2, maps_pb2, tracking_pb2

K = TypeVar("K")

_CAMERA_MODELS = {
    name: getattr(geometry_pb2, f"CAMERA_MODEL_ID_{name}") for name in CAMERA_MODELS
}
_CAMERA_NAMES = {number: name for name, number in _CAMERA_MODELS.items()}
_ENCODINGS = {
    Encoding.AUTO: tracking_pb2.IMAGE_ENCODING_UNSPECIFIED,
    Encoding.JPEG: tracking_pb2.IMAGE_ENCODING_JPEG,
    Encoding.PNG: tracking_pb2.IMAGE_ENCODING_PNG,
    Encoding.RAW_GRAY8: tracking_pb2.IMAGE_ENCODING_RAW_GRAY8,
    Encoding.RAW_BGR8: tracking_pb2.IMAGE_ENCODING_RAW_BGR8,
    Encoding.RAW_RGB8: tracking_pb2.IMAGE_ENCODING_RAW_RGB8,
}
_FLOW_MODES = {
    r.FlowMode.LOSSLESS: tracking_pb2.FLOW_MODE_LOSSLESS,
    r.FlowMode.LIVE: tracking_pb2.FLOW_MODE_LIVE,
}
_CAMERA_STATES = {
    getattr(tracking_pb2, f"CAMERA_STATE_{s.value}"): s for s in r.CameraState
}
_TARGET_STATES = {
    getattr(tracking_pb2, f"TARGET_STATE_{s.value}"): s for s in r.TargetState
}
_BODY_KINDS = {
    getattr(tracking_pb2, f"BODY_KIND_{kind.name}"): kind for kind in r.BodyKind
}
_BODY_KIND_NUMBERS = {kind: number for number, kind in _BODY_KINDS.items()}
_DROP_REASONS = {
    tracking_pb2.FrameDropped.REASON_OVERLOAD: r.DropReason.OVERLOAD,
    tracking_pb2.FrameDropped.REASON_SHUTDOWN: r.DropReason.SHUTDOWN,
}
_MOVERS_STATES = {
    getattr(tracking_pb2, f"MOVERS_STATE_{s.name}"): s
    for s in r.MoversState
    if s is not r.MoversState.NOT_ASKED
}
_GROUND_STATES = {
    getattr(maps_pb2, f"GROUND_STATE_{s.name}"): s for s in m.GroundState
}
_FORMATS = {
    m.MapFormat.AUTO: maps_pb2.MAP_FORMAT_UNSPECIFIED,
    m.MapFormat.COLMAP: maps_pb2.MAP_FORMAT_COLMAP,
    m.MapFormat.NVM: maps_pb2.MAP_FORMAT_NVM,
    m.MapFormat.BUNDLER: maps_pb2.MAP_FORMAT_BUNDLER,
    m.MapFormat.OPENMVG: maps_pb2.MAP_FORMAT_OPENMVG,
    m.MapFormat.OPENSFM: maps_pb2.MAP_FORMAT_OPENSFM,
    m.MapFormat.GROUNDLOCK: maps_pb2.MAP_FORMAT_GROUNDLOCK,
}
_EXPORT_FORMATS = {
    m.MapExportFormat.COLMAP: maps_pb2.MAP_EXPORT_FORMAT_COLMAP,
    m.MapExportFormat.COLMAP_TEXT: maps_pb2.MAP_EXPORT_FORMAT_COLMAP_TEXT,
    m.MapExportFormat.NVM: maps_pb2.MAP_EXPORT_FORMAT_NVM,
    m.MapExportFormat.PLY: maps_pb2.MAP_EXPORT_FORMAT_PLY,
    m.MapExportFormat.GROUNDLOCK: maps_pb2.MAP_EXPORT_FORMAT_GROUNDLOCK,
}


def _known(what: str, value: int, table: Dict[int, K]) -> K:
    if value not in table:
        raise InternalError(f"the server sent {what} {value}, which is not known here")
    return table[value]


# --- outwards ----------------------------------------------------------------


def vector_to(field: str, value: Any) -> Any:
    x, y, z = (float(v) for v in vector(field, value, 3))
    return geometry_pb2.Vector3(x=x, y=y, z=z)


def quaternion_to(q: Quaternion) -> Any:
    return geometry_pb2.Quaternion(w=q.w, x=q.x, y=q.y, z=q.z)


def similarity_to(s: SimilarityTransform) -> Any:
    return geometry_pb2.SimilarityTransform(
        scale=s.scale,
        rotation=quaternion_to(s.rotation),
        translation=vector_to("translation", s.translation),
    )


def geodetic_to(place: GeodeticPosition) -> Any:
    return geometry_pb2.GeodeticPosition(
        latitude_deg=place.latitude_deg,
        longitude_deg=place.longitude_deg,
        height_m=place.height_m,
    )


def box_to(field: str, value: Any) -> Any:
    box = Box2.of(field, value)
    return geometry_pb2.Box2(x=box.x, y=box.y, width=box.width, height=box.height)


def body_to(field: str, value: Any) -> Any:
    """A TargetBody, or its kind alone."""
    if isinstance(value, (r.BodyKind, str)):
        value = r.TargetBody(kind=value)
    if not isinstance(value, r.TargetBody):
        raise bad_argument(field, f"{value!r} must be a TargetBody or a kind of body")
    body = tracking_pb2.TargetBody()
    if value.kind is not None:
        kind = choice(f"{field}.kind", value.kind, r.BodyKind)
        body.kind = _BODY_KIND_NUMBERS[kind]
    if value.size_m is not None:
        body.size_m.CopyFrom(vector_to(f"{field}.size_m", value.size_m))
        for extent in (body.size_m.x, body.size_m.y, body.size_m.z):
            above_zero(f"{field}.size_m", extent)
    return body


def camera_to(camera: CameraModel) -> Any:
    return geometry_pb2.CameraModel(
        model=_CAMERA_MODELS[camera.model],
        width_px=camera.width_px,
        height_px=camera.height_px,
        params=camera.params,
    )


def image_to(image: Image) -> Any:
    return tracking_pb2.Image(
        encoding=_ENCODINGS[image.encoding],
        data=image.data,
        width_px=image.width_px,
        height_px=image.height_px,
    )


def format_to(value: Union[m.MapFormat, str]) -> Any:
    return _FORMATS[choice("format", value, m.MapFormat)]


def export_format_to(value: Union[m.MapExportFormat, str]) -> Any:
    return _EXPORT_FORMATS[choice("format", value, m.MapExportFormat)]


def options_to(options: r.SessionOptions) -> Any:
    message = tracking_pb2.SessionOptions(
        localizer=options.localizer,
        tracker=options.tracker,
        flow_mode=_FLOW_MODES[
            choice("options.flow_mode", options.flow_mode, r.FlowMode)
        ],
        seed=integer("options.seed", options.seed),
        report_matches=bool(options.report_matches),
        report_movers=bool(options.report_movers),
    )
    if options.confidence_threshold is not None:
        value = number("options.confidence_threshold", options.confidence_threshold)
        if not 0.0 < value < 1.0:
            raise bad_argument(
                "options.confidence_threshold", f"{value!r} must be in (0, 1)"
            )
        message.confidence_threshold = value
    if options.target_lost_after_s is not None:
        value = above_zero("options.target_lost_after_s", options.target_lost_after_s)
        message.target_lost_after_s = value
    if options.camera_lost_after_s is not None:
        value = number("options.camera_lost_after_s", options.camera_lost_after_s)
        if not 0.0 <= value <= 86400.0:
            raise bad_argument(
                "options.camera_lost_after_s", f"{value!r} must be in [0, 86400]"
            )
        message.camera_lost_after_s = value
    if options.imu is not None:
        message.imu.CopyFrom(imu_to(ImuModel.of("options.imu", options.imu)))
    return message


def imu_to(imu: ImuModel) -> Any:
    return tracking_pb2.ImuModel(
        imu_from_camera=quaternion_to(imu.imu_from_camera),
        gyroscope_noise_rad_s_sqrt_hz=imu.gyroscope_noise_rad_s_sqrt_hz,
        gyroscope_walk_rad_s2_sqrt_hz=imu.gyroscope_walk_rad_s2_sqrt_hz,
        gyroscope_bias_rad_s=imu.gyroscope_bias_rad_s,
    )


def prior_to(prior: r.PosePrior) -> Any:
    message = tracking_pb2.PosePrior()
    if prior.position_m is not None and prior.geodetic_position is not None:
        raise bad_argument(
            "prior.geodetic_position", "goes not together with prior.position_m"
        )
    for name, sigma in (
        ("position_m", "position_sigma_m"),
        ("geodetic_position", "geodetic_sigma_m"),
        ("rotation", "rotation_sigma_rad"),
    ):
        value, deviation = getattr(prior, name), getattr(prior, sigma)
        if value is None and deviation is None:
            continue
        if value is None:
            raise bad_argument(f"prior.{name}", f"is missing: prior.{sigma} is given")
        if deviation is None:
            raise bad_argument(
                f"prior.{sigma}", f"is missing: prior.{name} needs it, above 0"
            )
        setattr(message, sigma, above_zero(f"prior.{sigma}", deviation))
        if name == "position_m":
            message.position_m.CopyFrom(vector_to("prior.position_m", value))
        elif name == "geodetic_position":
            message.geodetic_position.CopyFrom(geodetic_to(value))
        else:
            message.rotation.CopyFrom(quaternion_to(value))
    if prior.position_arm_m is not None:
        if prior.position_m is None and prior.geodetic_position is None:
            raise bad_argument(
                "prior.position_arm_m",
                "goes with prior.position_m or prior.geodetic_position",
            )
        message.position_arm_m.CopyFrom(
            vector_to("prior.position_arm_m", prior.position_arm_m)
        )
    return message


def frame_to(frame: r.Frame, sequence: int, capture_time_ns: int) -> Any:
    message = tracking_pb2.TrackRequest()
    out = message.frame
    out.sequence = sequence
    out.capture_time_ns = capture_time_ns
    out.image.CopyFrom(image_to(Image.of(frame.image, field="frame.image")))
    if frame.camera is not None:
        camera = CameraModel.of("frame.camera", frame.camera)
        out.camera.CopyFrom(camera_to(camera))
    if frame.prior is not None:
        out.prior.CopyFrom(prior_to(frame.prior))
    if frame.inertial is not None:
        inertial_to(frame.inertial, out)
    return message


def inertial_to(samples: Any, out: Any) -> None:
    if not isinstance(samples, InertialSamples):
        raise bad_argument("frame.inertial", f"{samples!r} must be InertialSamples")
    if len(samples) > MAX_SAMPLES_PER_FRAME:
        raise bad_argument(
            "frame.inertial",
            f"{len(samples)} samples; a frame may bring {MAX_SAMPLES_PER_FRAME}",
        )
    rows = zip(
        samples.time_ns.tolist(),
        samples.angular_rate_rad_s.tolist(),
        samples.acceleration_m_s2.tolist(),
    )
    for time_ns, (wx, wy, wz), (ax, ay, az) in rows:
        sample = out.inertial.add()
        sample.time_ns = time_ns
        sample.angular_rate_rad_s.x = wx
        sample.angular_rate_rad_s.y = wy
        sample.angular_rate_rad_s.z = wz
        sample.acceleration_m_s2.x = ax
        sample.acceleration_m_s2.y = ay
        sample.acceleration_m_s2.z = az


# --- inwards -----------------------------------------------------------------


def time_from(stamp: Any) -> datetime:
    return datetime.fromtimestamp(stamp.seconds + 1e-9 * stamp.nanos, timezone.utc)


def vector_from(v: Any) -> Any:
    return frozen((v.x, v.y, v.z))


def quaternion_from(q: Any) -> Quaternion:
    return Quaternion(q.w, q.x, q.y, q.z)


def rigid_from(t: Any) -> RigidTransform:
    return RigidTransform(quaternion_from(t.rotation), vector_from(t.translation))


def similarity_from(s: Any) -> SimilarityTransform:
    return SimilarityTransform(
        s.scale, quaternion_from(s.rotation), vector_from(s.translation)
    )


def geodetic_from(g: Any) -> GeodeticPosition:
    return GeodeticPosition(g.latitude_deg, g.longitude_deg, g.height_m)


def camera_from(c: Any) -> CameraModel:
    name = _known("camera model", c.model, _CAMERA_NAMES)
    return CameraModel(name, c.width_px, c.height_px, tuple(c.params))


def image_from(i: Any) -> Image:
    encodings = {int(v): k for k, v in _ENCODINGS.items()}
    encoding = _known("image encoding", i.encoding, encodings)
    return Image(encoding, i.data, i.width_px, i.height_px)


def map_from(i: Any) -> m.MapInfo:
    return m.MapInfo(
        name=i.name,
        version=i.version,
        content_hash=i.content_hash,
        create_time=time_from(i.create_time),
        source_format=i.source_format,
        metric=i.metric,
        world_from_source=similarity_from(i.world_from_source),
        ground_world=Plane(vector_from(i.ground_world.normal), i.ground_world.d),
        num_cameras=i.num_cameras,
        num_views=i.num_views,
        num_landmarks=i.num_landmarks,
        num_observations=i.num_observations,
        mean_reprojection_error_px=i.mean_reprojection_error_px,
        has_descriptors=i.has_descriptors,
        file_bytes=i.file_bytes,
        origin=geodetic_from(i.origin) if i.HasField("origin") else None,
        lens=camera_from(i.lens) if i.HasField("lens") else None,
        ground_state=_GROUND_STATES.get(i.ground_state, m.GroundState.UNKNOWN),
        ground_sigma_deg=i.ground_sigma_deg,
        ground_height_sigma=i.ground_height_sigma,
        ground_relief_m=i.ground_relief_m,
        ground_relief_given=i.ground_relief_given,
    )


def build_report_from(result: Any) -> m.BuildReport:
    report = json.loads(result.report_json) if result.report_json else {}
    return m.BuildReport(map_from(result.map), tuple(result.warnings), report)


def align_report_from(a: Any) -> m.AlignReport:
    return m.AlignReport(
        map=map_from(a.map),
        new_world_from_world=similarity_from(a.new_world_from_world),
        residuals=tuple(
            m.AlignResidual(x.name, vector_from(x.error_m), x.used) for x in a.residuals
        ),
        rms_error_m=a.rms_error_m,
        rms_horizontal_error_m=a.rms_horizontal_error_m,
        median_error_m=a.median_error_m,
        max_error_m=a.max_error_m,
        warnings=tuple(a.warnings),
        terrain=(
            m.TerrainAgreement(
                a.terrain.offset_m,
                a.terrain.scatter_m,
                a.terrain.num_ground,
                a.terrain.num_landmarks,
            )
            if a.HasField("terrain")
            else None
        ),
    )


def map_camera_from(c: Any) -> m.MapCamera:
    return m.MapCamera(c.name, camera_from(c.camera), rigid_from(c.world_from_camera))


def session_from(s: Any) -> r.SessionInfo:
    o = s.options
    live = o.flow_mode == tracking_pb2.FLOW_MODE_LIVE
    return r.SessionInfo(
        session_id=s.session_id,
        map_name=s.map_name,
        map_version=s.map_version,
        camera=camera_from(s.camera) if s.HasField("camera") else None,
        options=r.SessionOptions(
            localizer=o.localizer,
            tracker=o.tracker,
            flow_mode=r.FlowMode.LIVE if live else r.FlowMode.LOSSLESS,
            confidence_threshold=_optional(o, "confidence_threshold"),
            target_lost_after_s=_optional(o, "target_lost_after_s"),
            camera_lost_after_s=_optional(o, "camera_lost_after_s"),
            seed=o.seed,
            report_matches=o.report_matches,
            report_movers=o.report_movers,
            imu=imu_from(o.imu) if o.HasField("imu") else None,
        ),
        create_time=time_from(s.create_time),
        next_sequence=s.next_sequence,
        frames_processed=s.frames_processed,
        frames_dropped=s.frames_dropped,
        frames_failed=s.frames_failed,
        target_ids=tuple(s.target_ids),
        streaming=s.streaming,
        owner=s.owner,
    )


def imu_from(i: Any) -> ImuModel:
    return ImuModel(
        quaternion_from(i.imu_from_camera),
        _optional(i, "gyroscope_noise_rad_s_sqrt_hz"),
        _optional(i, "gyroscope_walk_rad_s2_sqrt_hz"),
        _optional(i, "gyroscope_bias_rad_s"),
    )


def caller_from(c: Any) -> r.Caller:
    return r.Caller(c.name, c.tenant, tuple(c.scopes), c.open_to_all)


def _optional(message: Any, field: str) -> Optional[float]:
    return float(getattr(message, field)) if message.HasField(field) else None


def _square(values: Any, size: int) -> Any:
    if len(values) != size * size:
        return None
    return frozen(np.array(values).reshape(size, size))


def camera_result_from(c: Any) -> r.CameraResult:
    posed = c.HasField("world_from_camera")
    xy = frozen(c.match_xy_px, np.float32).reshape(-1, 2)
    xyz = frozen(c.match_xyz_m, np.float32).reshape(-1, 3)
    return r.CameraResult(
        state=_known("camera state", c.state, _CAMERA_STATES),
        world_from_camera=rigid_from(c.world_from_camera) if posed else None,
        covariance=_square(c.covariance, 6),
        num_inliers=c.num_inliers,
        mean_reprojection_error_px=c.mean_reprojection_error_px,
        reset_count=c.reset_count,
        lens_contradiction=(
            r.LensContradiction(
                c.lens_contradiction.focal_ratio, c.lens_contradiction.corner_share
            )
            if c.HasField("lens_contradiction")
            else None
        ),
        ignores_gyroscope=c.ignores_gyroscope,
        match_xy_px=xy,
        match_xyz_world=xyz,
    )


def target_from(t: Any) -> r.TargetResult:
    box = box3 = center = velocity = None
    if t.HasField("box"):
        box = Box2(t.box.x, t.box.y, t.box.width, t.box.height)
    if t.HasField("box_world"):
        pose = rigid_from(t.box_world.world_from_object)
        box3 = Box3(pose, vector_from(t.box_world.size_m))
    if t.HasField("ground_center_m"):
        center = vector_from(t.ground_center_m)
    if t.HasField("velocity_world_m_s"):
        velocity = vector_from(t.velocity_world_m_s)
    return r.TargetResult(
        target_id=t.target_id,
        state=_known("target state", t.state, _TARGET_STATES),
        confidence=t.confidence,
        box=box,
        box_world=box3,
        ground_center_m=center,
        heading_rad=t.heading_rad,
        ground_covariance_m2=_square(t.ground_covariance_m2, 2),
        velocity_world_m_s=velocity,
        age_s=t.age_s,
        heading_sigma_rad=t.heading_sigma_rad,
        front_known=t.front_known,
        size_covariance_m2=_square(t.size_covariance_m2, 3),
        body_kind=_BODY_KINDS.get(t.body_kind),
    )


def mover_from(v: Any) -> r.Mover:
    return r.Mover(
        mover_id=v.mover_id,
        box=Box2(v.box.x, v.box.y, v.box.width, v.box.height),
        ground_center_m=vector_from(v.ground_center_m),
        ground_covariance_m2=_square(v.ground_covariance_m2, 2),
        velocity_world_m_s=vector_from(v.velocity_world_m_s),
        velocity_covariance_m2_s2=_square(v.velocity_covariance_m2_s2, 2),
        confidence=v.confidence,
    )


def times_from(t: Any) -> r.StageTimes:
    return r.StageTimes(
        t.queue_ms, t.decode_ms, t.localize_ms, t.track_ms, t.total_ms, t.movers_ms
    )


def result_from(f: Any) -> r.FrameResult:
    return r.FrameResult(
        sequence=f.sequence,
        capture_time_ns=f.capture_time_ns,
        camera=camera_result_from(f.camera),
        targets=tuple(target_from(t) for t in f.targets),
        map_version=f.map_version,
        times=times_from(f.times),
        target_errors=tuple(
            r.TargetError(e.target_id, e.message) for e in f.target_errors
        ),
        movers=tuple(mover_from(v) for v in f.movers),
        # A newer server may have reasons that this client does not know.
        movers_state=_MOVERS_STATES.get(f.movers_state, r.MoversState.NOT_ASKED),
    )


def answer_from(response: Any) -> r.Answer:
    """The answer in a TrackResponse."""
    kind = response.WhichOneof("message")
    if kind == "result":
        return result_from(response.result)
    if kind == "error":
        e = response.error
        return r.FrameFailed(e.sequence, error_of(e.code, e.message))
    if kind == "dropped":
        d = response.dropped
        reason = _DROP_REASONS.get(d.reason, r.DropReason.UNKNOWN)
        return r.FrameDropped(d.sequence, reason)
    raise InternalError(f"the server sent an answer of kind {kind}")


def watch_from(w: Any) -> r.WatchUpdate:
    image = image_from(w.image) if w.HasField("image") else None
    return r.WatchUpdate(result_from(w.result), image, w.skipped)


def localize_from(response: Any) -> r.LocalizeReport:
    return r.LocalizeReport(
        camera_result_from(response.camera),
        response.map_version,
        times_from(response.times),
    )
