# SPDX-License-Identifier: Apache-2.0
"""An inertial measurement unit on the camera: its gyroscope tells how the camera
turned where the image is smeared. What it measures goes with the frames."""
from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Any, List, Optional, Tuple, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._values import Array, Value, frozen, number, vector
from .errors import InvalidArgumentError, bad_argument
from .geometry import Quaternion, _read_json

# TrackRequest.Frame.inertial
MAX_SAMPLES_PER_FRAME = 4096
_INT64_MAX = (1 << 63) - 1
_COLUMNS = ("timestamp [ns]", "w_x", "w_y", "w_z", "a_x", "a_y", "a_z")


@dataclass(frozen=True)
class ImuModel:
    """A unit that is fixed to the camera. The gyroscope's figures are as a data
    sheet or a calibration states them; None = those of a phone's."""

    imu_from_camera: Quaternion  # turns the camera's axes into the unit's
    gyroscope_noise_rad_s_sqrt_hz: Optional[float] = None
    gyroscope_walk_rad_s2_sqrt_hz: Optional[float] = None
    gyroscope_bias_rad_s: Optional[float] = None  # how far off zero at first

    def __post_init__(self) -> None:
        if not isinstance(self.imu_from_camera, Quaternion):
            raise bad_argument(
                "imu.imu_from_camera", f"{self.imu_from_camera!r} must be a Quaternion"
            )
        for name in _GYROSCOPE:
            value = getattr(self, name)
            if value is None:
                continue
            if number(f"imu.{name}", value) < 0.0:
                raise bad_argument(f"imu.{name}", f"{value!r} must not be negative")

    @staticmethod
    def of(field: str, value: Union[ImuModel, str, os.PathLike[str]]) -> ImuModel:
        """A unit, or the path of its imu.json."""
        if isinstance(value, ImuModel):
            return value
        if isinstance(value, (str, os.PathLike)):
            return ImuModel.read(value)
        raise bad_argument(
            field, f"{value!r} must be an ImuModel or the path of an imu.json"
        )

    @staticmethod
    def read(path: Union[str, os.PathLike[str]]) -> ImuModel:
        """From an imu.json, as `groundlock track --imu-model` takes it."""
        values = _read_json(path, ("imu_from_camera_wxyz",))
        rotation = vector(
            f"{path}: imu_from_camera_wxyz", values["imu_from_camera_wxyz"], 4
        )
        return ImuModel(
            Quaternion(*(float(v) for v in rotation)),
            *(values.get(name) for name in _GYROSCOPE),
        )


_GYROSCOPE = (
    "gyroscope_noise_rad_s_sqrt_hz",
    "gyroscope_walk_rad_s2_sqrt_hz",
    "gyroscope_bias_rad_s",
)


def _rows(field: str, value: ArrayLike, count: int) -> Array:
    try:
        array = frozen(value)
    except (TypeError, ValueError):
        raise bad_argument(field, "is not numbers") from None
    if array.shape != (count, 3):
        raise bad_argument(field, f"has shape {array.shape}, must be ({count}, 3)")
    if not np.isfinite(array).all():
        raise bad_argument(field, "is not finite")
    return array


@dataclass(frozen=True, eq=False)
class InertialSamples(Value):
    """What the unit measured, along its own axes; row i of all is one sample."""

    time_ns: NDArray[np.int64]  # (n,), of the clock of the frames; they ascend
    angular_rate_rad_s: Array  # (n, 3)
    acceleration_m_s2: Array  # (n, 3): specific force, at rest 9.8 upwards

    def __post_init__(self) -> None:
        times = np.asarray(self.time_ns)
        if times.ndim != 1 or (times.size and times.dtype.kind not in "iu"):
            raise bad_argument(
                "inertial.time_ns",
                f"is {times.dtype} of shape {times.shape}, must be whole numbers (n,)",
            )
        if times.size and not 0 <= int(times.min()) <= int(times.max()) <= _INT64_MAX:
            raise bad_argument("inertial.time_ns", f"must be in [0, {_INT64_MAX}]")
        times = frozen(times, np.int64)
        if (np.diff(times) <= 0).any():
            at = int(np.argmax(np.diff(times) <= 0)) + 1
            raise bad_argument(
                "inertial.time_ns",
                f"{times[at]} (row {at}) is not above {times[at - 1]}, the one before",
            )
        object.__setattr__(self, "time_ns", times)
        for name in ("angular_rate_rad_s", "acceleration_m_s2"):
            rows = _rows(f"inertial.{name}", getattr(self, name), len(times))
            object.__setattr__(self, name, rows)

    def __len__(self) -> int:
        return len(self.time_ns)

    @staticmethod
    def of(
        field: str, value: Union[InertialSamples, str, os.PathLike[str]]
    ) -> InertialSamples:
        """Samples, or the path of a recording: see read()."""
        if isinstance(value, InertialSamples):
            return value
        if isinstance(value, (str, os.PathLike)):
            return InertialSamples.read(value)
        raise bad_argument(
            field, f"{value!r} must be InertialSamples or the path of a recording"
        )

    @staticmethod
    def read(path: Union[str, os.PathLike[str]]) -> InertialSamples:
        """From a recording, as `groundlock track --imu` takes it: rows as in
        EuRoC's imu0/data.csv (time in ns, angular rate x, y, z in rad/s, specific
        force x, y, z in m/s^2). Lines that begin with # are passed over."""
        times: List[int] = []
        values: List[Tuple[float, ...]] = []
        try:
            with open(path, encoding="utf-8") as stream:
                for number_of_line, line in enumerate(stream, 1):
                    line = line.strip()
                    if line and not line.startswith("#"):
                        time, row = _parse(path, number_of_line, line)
                        times.append(time)
                        values.append(row)
        except OSError as error:
            raise bad_argument(str(path), f"cannot be read: {error.strerror}") from None
        except UnicodeDecodeError as error:
            raise bad_argument(str(path), f"is no text: {error}") from None
        table = np.array(values, dtype=np.float64).reshape(-1, 6)
        return InertialSamples(
            np.array(times, dtype=np.int64), table[:, :3], table[:, 3:]
        )

    def since(self, epoch_ns: int) -> InertialSamples:
        """Of a clock that is 0 when this one says `epoch_ns`: what the unit says
        when the video's clock begins. What was before that is left out."""
        times = self.time_ns - int(epoch_ns)
        return self._rows(times >= 0, times)

    def between(
        self, previous_ns: Optional[int], capture_time_ns: int
    ) -> InertialSamples:
        """What goes with a frame: those after the frame before (None = it is the
        first) up to the first one that is not before this one; the newest, if
        they are more than a frame may bring."""
        begin = 0
        if previous_ns is not None:
            begin = int(np.searchsorted(self.time_ns, previous_ns)) + 1
        end = int(np.searchsorted(self.time_ns, capture_time_ns)) + 1
        begin = max(begin, min(end, len(self)) - MAX_SAMPLES_PER_FRAME)
        return self._rows(slice(begin, max(begin, end)), self.time_ns)

    def _rows(self, which: Any, times: NDArray[np.int64]) -> InertialSamples:
        return InertialSamples(
            times[which], self.angular_rate_rad_s[which], self.acceleration_m_s2[which]
        )


def _parse(path: Any, number_of_line: int, line: str) -> Tuple[int, Tuple[float, ...]]:
    cells = [cell.strip() for cell in line.split(",")]

    def wrong(i: int) -> InvalidArgumentError:
        kind = "a number, finite" if i else "a whole number of nanoseconds, not below 0"
        problem = f"{cells[i]!r} is not {kind}" if i < len(cells) else "is missing"
        return bad_argument(
            str(path), f"line {number_of_line}, column {i + 1} ({_COLUMNS[i]}): {problem}"
        )

    values: List[float] = []
    for i in range(1, len(_COLUMNS)):
        try:
            values.append(float(cells[i]))
        except (ValueError, IndexError):
            raise wrong(i) from None
        if not math.isfinite(values[-1]):
            raise wrong(i)
    # int() takes "1_000", too.
    if not cells[0].isdecimal() or int(cells[0]) > _INT64_MAX:
        raise wrong(0)
    return int(cells[0]), tuple(values)
