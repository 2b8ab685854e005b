# SPDX-License-Identifier: Apache-2.0
"""The requests of both clients, from checked arguments."""
from __future__ import annotations

from typing import Any, List, Optional, Sequence

import numpy as np

from . import _align, _convert
from ._files import ImportFiles, LocalFile
from ._values import frozen, identifier, integer, map_name
from .errors import bad_argument
from .geometry import CameraModel, GeodeticPosition, SimilarityTransform
from .images import Image
from .maps import AlignMethod, Ground, PointCloud
from .results import PosePrior, SessionOptions
from .v1 import maps_pb2, tracking_pb2

PAGE_SIZE = 1000


def import_header(
    name: str,
    found: ImportFiles,
    world_from_source: Optional[SimilarityTransform],
    origin: Optional[GeodeticPosition],
    seed: int,
) -> Any:
    header = maps_pb2.ImportMapRequest.Header(
        name=map_name("name", name),
        format=_convert.format_to(found.format),
        model_path=found.model,
        database_path=found.database,
        images_path=found.images,
        seed=integer("seed", seed),
        num_files=len(found.files),
    )
    if world_from_source is not None:
        header.world_from_source.CopyFrom(_convert.similarity_to(world_from_source))
    if origin is not None:
        if world_from_source is None:
            raise bad_argument(
                "origin", "needs align: it says where that world lies on Earth"
            )
        header.origin.CopyFrom(_convert.geodetic_to(origin))
    return header


def alignment(align: Any) -> Optional[SimilarityTransform]:
    """A similarity, the path of an align.json, or None."""
    if align is None or isinstance(align, SimilarityTransform):
        return align
    return SimilarityTransform.read(align)


def build_header(
    name: str,
    files: Sequence[LocalFile],
    video_path: str,
    camera: Any,
    max_images: int,
    max_features: int,
    seed: int,
) -> Any:
    uint32 = (1 << 32) - 1
    header = maps_pb2.BuildMapRequest.Header(
        name=map_name("name", name),
        video_path=video_path,
        max_images=integer("max_images", max_images, 0, uint32),
        max_features=integer("max_features", max_features, 0, uint32),
        seed=integer("seed", seed),
        num_files=len(files),
    )
    if camera is not None:
        header.camera.CopyFrom(_convert.camera_to(CameraModel.of("camera", camera)))
    return header


def get_caller() -> Any:
    return tracking_pb2.GetCallerRequest()


def get_map(name: str, version: int) -> Any:
    return maps_pb2.GetMapRequest(
        name=map_name("name", name), version=integer("version", version)
    )


def list_maps(page_token: str) -> Any:
    return maps_pb2.ListMapsRequest(page_size=PAGE_SIZE, page_token=page_token)


def delete_map(name: str) -> Any:
    return maps_pb2.DeleteMapRequest(name=map_name("name", name))


def check_map(name: str, version: int) -> Any:
    return maps_pb2.CheckMapRequest(
        name=map_name("name", name), version=integer("version", version)
    )


def point_cloud(name: str, version: int, max_points: int) -> Any:
    return maps_pb2.GetPointCloudRequest(
        name=map_name("name", name),
        version=integer("version", version),
        max_points=integer("max_points", max_points),
    )


def export_map(name: str, version: int, format: Any) -> Any:
    return maps_pb2.ExportMapRequest(
        name=map_name("name", name),
        version=integer("version", version),
        format=_convert.export_format_to(format),
    )


def align_map(
    name: str,
    method: AlignMethod,
    origin: Optional[GeodeticPosition],
    ground: Ground,
    version: int,
    seed: int,
    report_only: bool,
) -> Any:
    request = maps_pb2.AlignMapRequest(
        name=map_name("name", name),
        version=integer("version", version),
        seed=integer("seed", seed),
        report_only=bool(report_only),
    )
    return _align.align_to(request, method, origin, ground)


class CloudBuilder:
    """Gathers the blocks of a point cloud."""

    def __init__(self) -> None:
        self._xyz: List[Any] = []
        self._rgb: List[bytes] = []
        self._cameras: List[Any] = []

    def take(self, block: Any) -> None:
        count = min(len(block.xyz_m) // 3, len(block.rgb) // 3)
        self._xyz.append(np.array(block.xyz_m[: 3 * count], dtype=np.float32))
        self._rgb.append(block.rgb[: 3 * count])
        self._cameras.extend(_convert.map_camera_from(c) for c in block.cameras)

    def cloud(self) -> PointCloud:
        xyz = np.concatenate(self._xyz) if self._xyz else np.zeros(0)
        rgb = np.frombuffer(b"".join(self._rgb), dtype=np.uint8)
        return PointCloud(
            frozen(xyz.reshape(-1, 3), np.float32),
            frozen(rgb.reshape(-1, 3), np.uint8),
            tuple(self._cameras),
        )


def create_session(
    map: Optional[str],
    camera: Any,
    options: Optional[SessionOptions],
    session_id: str,
    map_version: int,
) -> Any:
    return tracking_pb2.CreateSessionRequest(
        session_id=identifier("session_id", session_id, allow_empty=True),
        map_name="" if map is None else map_name("map", map),
        map_version=integer("map_version", map_version),
        camera=_lens(camera),
        options=_convert.options_to(options or SessionOptions()),
    )


def _lens(camera: Any) -> Any:
    """None = unset: the map's own."""
    if camera is None:
        return None
    return _convert.camera_to(CameraModel.of("camera", camera))


def list_sessions(page_token: str) -> Any:
    return tracking_pb2.ListSessionsRequest(page_size=PAGE_SIZE, page_token=page_token)


def get_session(session_id: str) -> Any:
    return tracking_pb2.GetSessionRequest(
        session_id=identifier("session_id", session_id)
    )


def delete_session(session_id: str) -> Any:
    return tracking_pb2.DeleteSessionRequest(
        session_id=identifier("session_id", session_id)
    )


def set_target(
    session_id: str, target_id: str, box: Any, sequence: Optional[int], body: Any
) -> Any:
    request = tracking_pb2.SetTargetRequest(
        session_id=session_id,
        target_id=identifier("target_id", target_id, allow_empty=True),
        box=_convert.box_to("box", box),
    )
    if sequence is not None:
        request.sequence = integer("sequence", sequence)
    if body is not None:
        request.body.CopyFrom(_convert.body_to("body", body))
    return request


def move_target(session_id: str, target_id: str, box: Any) -> Any:
    return tracking_pb2.MoveTargetRequest(
        session_id=session_id,
        target_id=identifier("target_id", target_id),
        box=_convert.box_to("box", box),
    )


def drop_target(session_id: str, target_id: str) -> Any:
    return tracking_pb2.DropTargetRequest(
        session_id=session_id, target_id=identifier("target_id", target_id)
    )


def watch(session_id: str, include_images: bool, image_width_px: int) -> Any:
    return tracking_pb2.WatchSessionRequest(
        session_id=identifier("session_id", session_id),
        include_images=bool(include_images),
        image_width_px=integer("image_width_px", image_width_px, 0, (1 << 32) - 1),
    )


def localize(
    image: Any,
    map: str,
    camera: Any,
    localizer: str,
    map_version: int,
    seed: int,
    prior: Optional[PosePrior],
) -> Any:
    request = tracking_pb2.LocalizeRequest(
        map_name=map_name("map", map),
        map_version=integer("map_version", map_version),
        camera=_lens(camera),
        image=_convert.image_to(Image.of(image)),
        localizer=localizer,
        seed=integer("seed", seed),
    )
    if prior is not None:
        request.prior.CopyFrom(_convert.prior_to(prior))
    return request


