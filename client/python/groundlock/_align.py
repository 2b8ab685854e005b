# SPDX-License-Identifier: Apache-2.0
"""What a map is to be aligned by, as a request."""
from __future__ import annotations

from typing import Any, Optional

import numpy as np

from . import _convert
from . import maps as m
from ._values import above_zero, number
from .errors import bad_argument
from .geometry import GeodeticPosition, Plane
from .v1 import maps_pb2


def _map_point_to(field: str, point: m.MapPoint) -> Any:
    message = maps_pb2.AlignMapRequest.MapPoint()
    if point.position_world is not None:
        position = _convert.vector_to(f"{field}.position_world", point.position_world)
        message.position_world.CopyFrom(position)
    for p in point.pixels:
        message.pixels.add(
            image=p.image,
            x_px=number(f"{field}.pixels.x_px", p.x_px),
            y_px=number(f"{field}.pixels.y_px", p.y_px),
        )
    if point.position_world is None and len(point.pixels) < 2:
        raise bad_argument(
            field, "needs position_world, or pixels in two or more mapping images"
        )
    return message


def _place_to(field: str, place: Any) -> Any:
    if isinstance(place, GeodeticPosition):
        return maps_pb2.AlignMapRequest.Place(geodetic=_convert.geodetic_to(place))
    return maps_pb2.AlignMapRequest.Place(position_m=_convert.vector_to(field, place))


def _set_method(method: m.AlignMethod, request: Any) -> None:
    if isinstance(method, m.NewWorldFromSource):
        request.new_world_from_source.CopyFrom(_convert.similarity_to(method.transform))
    elif isinstance(method, m.NewWorldFromWorld):
        request.new_world_from_world.CopyFrom(_convert.similarity_to(method.transform))
    elif isinstance(method, m.KnownDistance):
        distance = request.known_distance
        getattr(distance, "from").CopyFrom(_map_point_to("start", method.start))
        distance.to.CopyFrom(_map_point_to("end", method.end))
        distance.distance_m = above_zero("distance_m", method.distance_m)
    elif isinstance(method, m.ControlPoints):
        if len(method.points) < 3:
            raise bad_argument("points", f"{len(method.points)} given, needs 3 or more")
        for i, p in enumerate(method.points):
            request.control_points.points.add(
                name=p.name,
                point=_map_point_to(f"points[{i}].point", p.point),
                place=_place_to(f"points[{i}].place", p.place),
            )
    elif isinstance(method, m.CameraPositions):
        if len(method.positions) < 3:
            count = len(method.positions)
            raise bad_argument("positions", f"{count} given, needs 3 or more")
        for image, place in method.positions.items():
            request.camera_positions.positions.add(
                image=image, place=_place_to(f"positions[{image!r}]", place)
            )
        request.camera_positions.accuracy_m = number("accuracy_m", method.accuracy_m)
    elif method is not None:
        kinds = "NewWorldFromSource, NewWorldFromWorld, KnownDistance, ControlPoints"
        raise bad_argument(
            "method",
            f"{type(method).__name__} must be one of {kinds}, CameraPositions or None",
        )


def _terrain_to(terrain: m.Terrain) -> Any:
    heights = np.asarray(terrain.z_m, dtype=np.float32)
    if heights.ndim != 2 or min(heights.shape) < 3:
        raise bad_argument(
            "ground.z_m", f"shape {heights.shape} must be rows and columns, at least 3 x 3"
        )
    message = maps_pb2.AlignMapRequest.Terrain(
        first_x_m=number("ground.first_x_m", terrain.first_x_m),
        first_y_m=number("ground.first_y_m", terrain.first_y_m),
        step_m=above_zero("ground.step_m", terrain.step_m),
        columns=heights.shape[1],
        sigma_m=number("ground.sigma_m", terrain.sigma_m),
        fit_height=terrain.fit_height,
    )
    message.z_m.extend(heights.ravel().tolist())
    return message


def _set_ground(ground: m.Ground, request: Any) -> None:
    if ground is None:
        return
    if isinstance(ground, Plane):
        request.ground_plane_world.normal.CopyFrom(_convert.vector_to("ground", ground.normal))
        request.ground_plane_world.d = ground.d
    elif isinstance(ground, m.Terrain):
        request.ground_terrain.CopyFrom(_terrain_to(ground))
    elif isinstance(ground, str):
        if ground != "automatic":
            raise bad_argument(
                "ground", f"{ground!r} must be 'automatic', a point, a Plane or a Terrain"
            )
        request.ground_automatic = True
    else:
        request.ground_seed_world.CopyFrom(_convert.vector_to("ground", ground))


def align_to(
    request: Any,
    method: m.AlignMethod,
    origin: Optional[GeodeticPosition],
    ground: m.Ground,
) -> Any:
    _set_method(method, request)
    _set_ground(ground, request)
    if origin is not None:
        request.origin.CopyFrom(_convert.geodetic_to(origin))
    return request


