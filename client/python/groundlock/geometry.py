# SPDX-License-Identifier: Apache-2.0
"""Poses, boxes and lenses.

Lengths are metres if the map is metric, else the map's unit; angles radians;
image coordinates pixels with the centre of the first pixel at (0.5, 0.5).
Frames: world (z up, ground near z = 0), camera (x right, y down, z forward),
object (x along the heading, y left, z up). A transform `target_from_source`
takes points of `source` to `target`.
"""
from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Sequence, Tuple, Union

import numpy as np
from numpy.typing import ArrayLike

from ._values import Array, Value, above_zero, frozen, integer, number, vector
from .errors import bad_argument, unknown_choice


@dataclass(frozen=True)
class Quaternion:
    """A unit quaternion; what is passed in need not have length 1."""

    w: float
    x: float
    y: float
    z: float

    def __post_init__(self) -> None:
        parts = [number(f"quaternion.{n}", getattr(self, n)) for n in "wxyz"]
        length = math.sqrt(sum(p * p for p in parts))
        if length < 1e-12:
            raise bad_argument("quaternion", "has length 0, must be a rotation")
        for name, part in zip("wxyz", parts):
            # One that has unit length already keeps its digits.
            value = part if abs(length - 1.0) < 1e-12 else part / length
            object.__setattr__(self, name, value)

    @staticmethod
    def identity() -> Quaternion:
        return Quaternion(1.0, 0.0, 0.0, 0.0)

    @staticmethod
    def from_matrix(matrix: ArrayLike) -> Quaternion:
        """Of a 3x3 rotation matrix.

        Source: Shepperd, "Quaternion from rotation matrix" (1978): the largest
        component is found first, so that nothing is divided by a small number.
        """
        m = np.asarray(matrix, dtype=np.float64)
        if m.shape != (3, 3):
            raise bad_argument("matrix", f"has shape {m.shape}, must be (3, 3)")
        if not np.allclose(m @ m.T, np.eye(3), atol=1e-6) or np.linalg.det(m) < 0:
            raise bad_argument("matrix", "is not a rotation: R R^T must be 1, det R 1")
        squares = np.array(
            [
                1 + m[0, 0] + m[1, 1] + m[2, 2],
                1 + m[0, 0] - m[1, 1] - m[2, 2],
                1 - m[0, 0] + m[1, 1] - m[2, 2],
                1 - m[0, 0] - m[1, 1] + m[2, 2],
            ]
        )
        k = int(np.argmax(squares))
        columns = [
            [squares[0], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], squares[1], m[1, 0] + m[0, 1], m[0, 2] + m[2, 0]],
            [m[0, 2] - m[2, 0], m[1, 0] + m[0, 1], squares[2], m[2, 1] + m[1, 2]],
            [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[2, 1] + m[1, 2], squares[3]],
        ]
        return Quaternion(*(float(v) for v in columns[k]))

    @staticmethod
    def from_rotation_vector(rotation_vector: ArrayLike) -> Quaternion:
        """Axis times angle, rad (the exponential map)."""
        v = vector("rotation_vector", rotation_vector, 3)
        angle = float(np.linalg.norm(v))
        s = 0.5 * float(np.sinc(0.5 * angle / np.pi))
        return Quaternion(math.cos(0.5 * angle), *(float(s * c) for c in v))

    def to_matrix(self) -> Array:
        """The 3x3 rotation matrix."""
        w, x, y, z = self.w, self.x, self.y, self.z
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )

    def inverse(self) -> Quaternion:
        return Quaternion(self.w, -self.x, -self.y, -self.z)

    def __matmul__(self, other: Quaternion) -> Quaternion:
        """The rotation by `other`, then by this."""
        a, b = self, other
        return Quaternion(
            a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
            a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
            a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
            a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
        )

    def angle_to(self, other: Quaternion) -> float:
        """The angle between two rotations, rad, in [0, pi]."""
        d = self.inverse() @ other
        return 2.0 * math.atan2(math.hypot(d.x, d.y, d.z), abs(d.w))


def _matrix(scale: float, rotation: Quaternion, translation: Array) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3] = scale * rotation.to_matrix()
    matrix[:3, 3] = translation
    return matrix


@dataclass(frozen=True, eq=False)
class RigidTransform(Value):
    """target_from_source: x_target = rotation x_source + translation."""

    rotation: Quaternion
    translation: Array

    def __post_init__(self) -> None:
        value = vector("translation", self.translation, 3)
        object.__setattr__(self, "translation", value)

    @staticmethod
    def identity() -> RigidTransform:
        return RigidTransform(Quaternion.identity(), np.zeros(3))

    @staticmethod
    def from_matrix(matrix: ArrayLike) -> RigidTransform:
        """Of a 4x4 (or 3x4) homogeneous matrix."""
        m = np.asarray(matrix, dtype=np.float64)
        if m.shape not in ((4, 4), (3, 4)):
            raise bad_argument("matrix", f"has shape {m.shape}, must be (4, 4)")
        return RigidTransform(Quaternion.from_matrix(m[:3, :3]), m[:3, 3])

    def to_matrix(self) -> Array:
        """The 4x4 homogeneous matrix."""
        return _matrix(1.0, self.rotation, self.translation)

    def inverse(self) -> RigidTransform:
        back = self.rotation.inverse()
        return RigidTransform(back, -(back.to_matrix() @ self.translation))

    def apply(self, points: ArrayLike) -> Array:
        """Points of the source, (..., 3), in the target."""
        p = np.asarray(points, dtype=np.float64)
        return np.asarray(p @ self.rotation.to_matrix().T + self.translation)

    def __matmul__(self, other: RigidTransform) -> RigidTransform:
        """a_from_b @ b_from_c = a_from_c."""
        return RigidTransform(
            self.rotation @ other.rotation, self.apply(other.translation)
        )


@dataclass(frozen=True, eq=False)
class SimilarityTransform(Value):
    """target_from_source: x_target = scale rotation x_source + translation."""

    scale: float
    rotation: Quaternion
    translation: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "scale", above_zero("scale", self.scale))
        value = vector("translation", self.translation, 3)
        object.__setattr__(self, "translation", value)

    @staticmethod
    def read(path: Union[str, os.PathLike[str]]) -> SimilarityTransform:
        """From an align.json, as `groundlock map import --align` takes it."""
        values = _read_json(path, ("scale", "rotation_wxyz", "translation"))
        rotation = vector(f"{path}: rotation_wxyz", values["rotation_wxyz"], 4)
        return SimilarityTransform(
            above_zero(f"{path}: scale", values["scale"]),
            Quaternion(*(float(v) for v in rotation)),
            vector(f"{path}: translation", values["translation"], 3),
        )

    def to_matrix(self) -> Array:
        """The 4x4 homogeneous matrix."""
        return _matrix(self.scale, self.rotation, self.translation)

    def apply(self, points: ArrayLike) -> Array:
        """Points of the source, (..., 3), in the target."""
        p = np.asarray(points, dtype=np.float64)
        rotated = p @ self.rotation.to_matrix().T
        return np.asarray(self.scale * rotated + self.translation)

    def inverse(self) -> SimilarityTransform:
        back = self.rotation.inverse()
        shift = back.to_matrix() @ self.translation
        return SimilarityTransform(1.0 / self.scale, back, -shift / self.scale)


@dataclass(frozen=True, eq=False)
class Plane(Value):
    """normal . x + d = 0, with a unit normal."""

    normal: Array
    d: float

    def __post_init__(self) -> None:
        normal = vector("plane.normal", self.normal, 3)
        object.__setattr__(self, "normal", normal)
        object.__setattr__(self, "d", number("plane.d", self.d))


@dataclass(frozen=True)
class GeodeticPosition:
    """A place on Earth, WGS84."""

    latitude_deg: float
    longitude_deg: float
    height_m: float = 0.0

    def __post_init__(self) -> None:
        for name, bound in (("latitude_deg", 90.0), ("longitude_deg", 180.0)):
            value = number(name, getattr(self, name))
            if abs(value) > bound:
                raise bad_argument(name, f"{value!r} must be in [-{bound}, {bound}]")
            object.__setattr__(self, name, value)
        object.__setattr__(self, "height_m", number("height_m", self.height_m))


@dataclass(frozen=True)
class Box2:
    """A box in the image, px: it covers [x, x + width) and so on."""

    x: float
    y: float
    width: float
    height: float

    @staticmethod
    def of(field: str, value: Union[Box2, Sequence[float]]) -> Box2:
        """A box, or (x, y, width, height); checked."""
        if not isinstance(value, Box2):
            value = Box2(*(float(v) for v in vector(field, value, 4)))
        number(f"{field}.x", value.x)
        number(f"{field}.y", value.y)
        above_zero(f"{field}.width", value.width)
        above_zero(f"{field}.height", value.height)
        return value

    @property
    def center(self) -> Tuple[float, float]:
        return (self.x + 0.5 * self.width, self.y + 0.5 * self.height)

    def as_tuple(self) -> Tuple[float, float, float, float]:
        return (self.x, self.y, self.width, self.height)

    def iou(self, other: Box2) -> float:
        """Intersection over union, in [0, 1]."""
        right = min(self.x + self.width, other.x + other.width)
        bottom = min(self.y + self.height, other.y + other.height)
        w = max(0.0, right - max(self.x, other.x))
        h = max(0.0, bottom - max(self.y, other.y))
        union = self.width * self.height + other.width * other.height - w * h
        return w * h / union if union > 0.0 else 0.0


@dataclass(frozen=True, eq=False)
class Box3(Value):
    """An upright box in the world: its middle and orientation, and its extent
    along the object's x (length), y (width) and z (height)."""

    world_from_object: RigidTransform
    size_m: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "size_m", frozen(self.size_m))

    def corners(self) -> Array:
        """The eight corners in world, (8, 3); the lower four first."""
        signs = [(x, y, z) for z in (-1, 1) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        return self.world_from_object.apply(0.5 * np.array(signs) * self.size_m)


# Parameters of the lens models, in order, as COLMAP has them.
CAMERA_MODELS: Dict[str, Tuple[str, ...]] = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "OPENCV_FISHEYE": ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
}


@dataclass(frozen=True)
class CameraModel:
    """A lens: COLMAP's name of the model, the image's size, the parameters."""

    model: str
    width_px: int
    height_px: int
    params: Tuple[float, ...]

    def __post_init__(self) -> None:
        names = CAMERA_MODELS.get(self.model)
        if names is None:
            raise unknown_choice("camera.model", self.model, CAMERA_MODELS)
        for name in ("width_px", "height_px"):
            pixels = integer(f"camera.{name}", getattr(self, name), 1, 65535)
            object.__setattr__(self, name, pixels)
        params = np.atleast_1d(np.asarray(self.params, dtype=object))
        if params.shape != (len(names),):
            raise bad_argument(
                "camera.params",
                f"{params.size} given, but {self.model} has {len(names)}: "
                + ", ".join(names),
            )
        values = tuple(
            number(f"camera.params ({name})", value)
            for name, value in zip(names, params)
        )
        for name, value in zip(names, values):
            if name.startswith("f"):
                above_zero(f"camera.params ({name})", value)
        object.__setattr__(self, "params", values)

    @staticmethod
    def of(
        field: str, value: Union[CameraModel, str, os.PathLike[str], None]
    ) -> CameraModel:
        """A lens, or the path of its camera.json."""
        if isinstance(value, CameraModel):
            return value
        if isinstance(value, (str, os.PathLike)):
            return CameraModel.read(value)
        raise bad_argument(
            field, f"{value!r} must be a CameraModel or the path of a camera.json"
        )

    @staticmethod
    def read(path: Union[str, os.PathLike[str]]) -> CameraModel:
        """From a camera.json, as `groundlock track --camera` takes it."""
        values = _read_json(path, ("model", "width", "height", "params"))
        return CameraModel(
            values["model"], values["width"], values["height"], values["params"]
        )

    def write(self, path: Union[str, os.PathLike[str]]) -> None:
        """As a camera.json."""
        content = {
            "width": self.width_px,
            "height": self.height_px,
            "model": self.model,
            "params": list(self.params),
        }
        Path(path).write_text(json.dumps(content) + "\n", encoding="utf-8")


def _read_json(
    path: Union[str, os.PathLike[str]], keys: Sequence[str]
) -> Dict[str, Any]:
    try:
        values = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise bad_argument(str(path), f"cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise bad_argument(str(path), f"is not JSON: {error}") from None
    missing = [k for k in keys if not isinstance(values, dict) or k not in values]
    if missing:
        raise bad_argument(
            str(path), f"{missing[0]} is missing; needs {', '.join(keys)}"
        )
    return dict(values)
