# SPDX-License-Identifier: Apache-2.0
"""Maps and what is done to them; units and frames as in geometry."""
from __future__ import annotations

import enum
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Callable, Dict, Optional, Sequence, Tuple, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._values import Value
from .geometry import (
    CameraModel,
    GeodeticPosition,
    Plane,
    RigidTransform,
    SimilarityTransform,
)


class MapFormat(enum.Enum):
    """What a reconstruction was written by."""

    AUTO = "auto"
    COLMAP = "colmap"
    NVM = "nvm"
    BUNDLER = "bundler"
    OPENMVG = "openmvg"
    OPENSFM = "opensfm"
    GROUNDLOCK = "groundlock"


class GroundState(enum.Enum):
    """How much is known of a map's ground."""

    UNKNOWN = "unknown"  # sessions give poses and 2D boxes, no boxes in the world
    ESTIMATED = "estimated"  # found in the map: ground_sigma_deg says how sure
    MEASURED = "measured"  # given with the world


class MapExportFormat(enum.Enum):
    """What a map is written as."""

    COLMAP = "colmap"  # a folder: binary model and database.db
    COLMAP_TEXT = "colmap-text"  # a folder
    NVM = "nvm"
    PLY = "ply"
    GROUNDLOCK = "groundlock"  # the map file itself (.glmap)


@dataclass(frozen=True, eq=False)
class MapInfo(Value):
    """A version of a map."""

    name: str
    version: int
    content_hash: str
    create_time: datetime  # UTC
    source_format: str
    metric: bool  # world is in metres
    world_from_source: SimilarityTransform
    ground_world: Plane
    num_cameras: int
    num_views: int
    num_landmarks: int
    num_observations: int
    mean_reprojection_error_px: float
    has_descriptors: bool  # without them no camera can be localised
    file_bytes: int
    origin: Optional[GeodeticPosition]  # world is east, north, up of it
    # Of all its images, if they have one and the same: sessions that name no
    # camera take it.
    lens: Optional[CameraModel]
    ground_state: GroundState
    ground_sigma_deg: float  # of its tilt about any axis in it; 0 = not stated
    # Of its cameras' mean height over it, as a share of that; 0 = not stated.
    ground_height_sigma: float
    ground_relief_m: float  # by which its heights differ; 0 = it is the plane
    ground_relief_given: bool  # they are a terrain's, not what landmarks tell


@dataclass(frozen=True)
class ImportReport:
    """What an import has made; warnings: what was left out or assumed."""

    map: MapInfo
    warnings: Tuple[str, ...]


@dataclass(frozen=True)
class BuildReport:
    """What a build has made."""

    map: MapInfo
    warnings: Tuple[str, ...]
    report: Dict[str, Any]  # as `groundlock map build --json` prints it


@dataclass(frozen=True)
class MapCheck:
    """Whether a stored map is sound."""

    map: Optional[MapInfo]  # None if the file cannot even be opened
    problems: Tuple[str, ...]  # empty = the map is sound


@dataclass(frozen=True, eq=False)
class MapCamera(Value):
    """A mapping image: its lens and where it was taken."""

    name: str
    camera: CameraModel
    world_from_camera: RigidTransform


@dataclass(frozen=True, eq=False)
class PointCloud(Value):
    """Landmarks; row i of `xyz_world` and of `rgb` are of one."""

    xyz_world: NDArray[np.float32]  # (n, 3)
    rgb: NDArray[np.uint8]  # (n, 3)
    cameras: Tuple[MapCamera, ...]


# --- progress ----------------------------------------------------------------


@dataclass(frozen=True)
class Progress:
    """How far a long call is. A callback that raises ends the call, which
    leaves nothing behind; what it raised goes on to the caller."""

    # "uploading", "importing", "preparing", "aligning", "downloading", or a build's
    stage: str
    fraction: float  # of this stage, 0 to 1
    note: str = ""
    bytes_done: int = 0
    bytes_total: int = 0


OnProgress = Callable[[Progress], Any]

# All that is known of an alignment before it is done.
ALIGNING = Progress("aligning", 0.0)


# --- alignment ---------------------------------------------------------------

# A measured place: (x, y, z) in the new world, m, or on Earth.
Place = Union[ArrayLike, GeodeticPosition]


@dataclass(frozen=True)
class Pixel:
    """Where a mapping image shows a point."""

    image: str  # its name
    x_px: float
    y_px: float


@dataclass(frozen=True, eq=False)
class MapPoint(Value):
    """A point of the map: its place in the map's present world, or its pixels
    in two or more mapping images."""

    position_world: Optional[ArrayLike] = None
    pixels: Sequence[Pixel] = ()


@dataclass(frozen=True)
class NewWorldFromSource:
    """By a similarity from the reconstruction that was imported."""

    transform: SimilarityTransform


@dataclass(frozen=True)
class NewWorldFromWorld:
    """By a similarity from the map's present world."""

    transform: SimilarityTransform


@dataclass(frozen=True)
class KnownDistance:
    """Two points and the distance between them: sets the scale."""

    start: MapPoint
    end: MapPoint
    distance_m: float


@dataclass(frozen=True, eq=False)
class ControlPoint(Value):
    """A point of the map whose place was measured."""

    name: str  # for the report
    point: MapPoint
    place: Place


@dataclass(frozen=True)
class ControlPoints:
    """At least 3 points, not on a line."""

    points: Sequence[ControlPoint]


@dataclass(frozen=True)
class CameraPositions:
    """Where mapping images were taken, by their names; at least 3. Robust:
    positions that do not fit the others are left out."""

    positions: Dict[str, Place]
    accuracy_m: float = 0.0  # 1 sigma of a good one, per axis; 0 = 3 m


AlignMethod = Union[
    NewWorldFromSource,
    NewWorldFromWorld,
    KnownDistance,
    ControlPoints,
    CameraPositions,
    None,
]

@dataclass(frozen=True, eq=False)
class Terrain(Value):
    """Heights of the ground, say of an elevation model, in the map's present
    world, which must be metric with z up: on a regular grid over x and y.
    Stays with the map until it is aligned anew."""

    z_m: ArrayLike  # rows along y, columns along x, at least 3 x 3; NaN = unknown
    first_x_m: float  # of z_m[0, 0]
    first_y_m: float
    step_m: float
    sigma_m: float = 0.0  # 0 = as the map's own ground scatters about it
    fit_height: bool = False  # move it to the ground that the landmarks show


# Where the ground is, in the map's present world: a point on it, its plane, its
# heights (with no method) or "automatic"; None = as is best for the method.
Ground = Union[ArrayLike, Plane, Terrain, str, None]


@dataclass(frozen=True)
class TerrainAgreement:
    """How a map's landmarks lie to the terrain that was given."""

    offset_m: float  # the map's ground over the terrain
    scatter_m: float  # 1 sigma about it
    num_ground: int  # landmarks on the ground
    num_landmarks: int


@dataclass(frozen=True, eq=False)
class AlignResidual(Value):
    """How well a point or image fits: the aligned map's minus the measured."""

    name: str
    error_m: NDArray[np.float64]
    used: bool  # False: did not fit and was left out


@dataclass(frozen=True)
class AlignReport:
    """A map in its new world, and how well what was given fits."""

    map: MapInfo  # as published, or as it would be
    new_world_from_world: SimilarityTransform
    residuals: Tuple[AlignResidual, ...]
    rms_error_m: float
    rms_horizontal_error_m: float
    median_error_m: float
    max_error_m: float
    warnings: Tuple[str, ...]
    terrain: Optional[TerrainAgreement]  # None = none given, or too few landmarks
