# SPDX-License-Identifier: Apache-2.0
"""Answers as a table: one row for each frame and target, with the columns and
digits of `groundlock track --results`; empty = there is none."""
from __future__ import annotations

import csv
import math
import os
import tempfile
from pathlib import Path
from typing import Any, Dict, Iterable, Iterator, List, Mapping, Optional, Union

from .errors import FailedPreconditionError, bad_argument
from .results import Answer, CameraResult, FrameResult, StageTimes, TargetResult

# (name, decimals; None = text or a whole number)
_COLUMNS: Dict[str, Optional[int]] = {
    "frame": None,
    "t_s": 6,
    "camera_state": None,
    **{f"cam_{n}": 6 for n in ("x", "y", "z")},
    **{f"cam_q{n}": 9 for n in ("w", "x", "y", "z")},
    "inliers": None,
    "target": None,
    "target_state": None,
    "confidence": 4,
    **{f"box_{n}": 3 for n in ("x", "y", "w", "h")},
    **{f"ground_{n}": 6 for n in ("x", "y", "z")},
    "heading_rad": 6,
    **{f"{n}_m": 4 for n in ("length", "width", "height")},
    **{f"{n}_ms": 3 for n in ("decode", "localize", "track", "total")},
}
COLUMNS = tuple(_COLUMNS)

Row = Dict[str, Any]


def _camera(camera: CameraResult) -> Row:
    row: Row = {"camera_state": camera.state.value, "inliers": max(0, camera.num_inliers)}
    pose = camera.world_from_camera
    if pose is not None:
        for name, value in zip("xyz", pose.translation):
            row[f"cam_{name}"] = float(value)
        for name in "wxyz":
            row[f"cam_q{name}"] = getattr(pose.rotation, name)
    return row


def _target(target: TargetResult) -> Row:
    row: Row = {
        "target": target.target_id,
        "target_state": target.state.value,
        "confidence": target.confidence,
    }
    if target.box is not None:
        row.update(zip(("box_x", "box_y", "box_w", "box_h"), target.box.as_tuple()))
    if target.ground_center_m is not None:
        for name, value in zip("xyz", target.ground_center_m):
            row[f"ground_{name}"] = float(value)
        row["heading_rad"] = target.heading_rad
    if target.box_world is not None:
        size = (float(v) for v in target.box_world.size_m)
        row.update(zip(("length_m", "width_m", "height_m"), size))
    return row


def _times(times: StageTimes) -> Row:
    names = ("decode_ms", "localize_ms", "track_ms", "total_ms")
    return {name: getattr(times, name) for name in names}


def rows(
    answers: Iterable[Answer], capture_times_ns: Optional[Mapping[int, int]] = None
) -> Iterator[Row]:
    """The rows; what there is none of is missing. capture_times_ns: by
    sequence, of frames that failed or were dropped: their answers have none."""
    for answer in answers:
        if not isinstance(answer, FrameResult):
            row: Row = {"frame": answer.sequence}
            if capture_times_ns and answer.sequence in capture_times_ns:
                row["t_s"] = 1e-9 * capture_times_ns[answer.sequence]
            yield row
            continue
        start = {"frame": answer.sequence, "t_s": 1e-9 * answer.capture_time_ns}
        common = {**start, **_camera(answer.camera), **_times(answer.times)}
        for target in answer.targets:
            yield {**common, **_target(target)}
        if not answer.targets:
            yield common


def _text(name: str, value: Any) -> str:
    decimals = _COLUMNS[name]
    if value is None:
        return ""
    if decimals is None:
        return str(value)
    return f"{value:.{decimals}f}" if math.isfinite(value) else ""


def write_csv(
    path: Union[str, "os.PathLike[str]"],
    answers: Iterable[Answer],
    capture_times_ns: Optional[Mapping[int, int]] = None,
) -> int:
    """Writes the table, whole or not at all; returns the number of rows."""
    target = Path(path).absolute()
    count = 0
    try:
        handle, scratch = tempfile.mkstemp(prefix=".groundlock-", dir=target.parent)
    except OSError as error:
        raise bad_argument("path", f"{path}: {error.strerror}") from None
    try:
        with os.fdopen(handle, "w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(COLUMNS)
            for row in rows(answers, capture_times_ns):
                writer.writerow([_text(name, row.get(name)) for name in COLUMNS])
                count += 1
        os.chmod(scratch, 0o644)
        os.replace(scratch, target)
    except BaseException:
        os.unlink(scratch)
        raise
    return count


def to_frame(
    answers: Iterable[Answer], capture_times_ns: Optional[Mapping[int, int]] = None
) -> Any:
    """The table as a pandas.DataFrame; numbers that are missing are NaN."""
    try:
        import pandas
    except ImportError:
        raise FailedPreconditionError(
            "a DataFrame needs pandas (Debian: python3-pandas)"
        ) from None
    content: List[Row] = list(rows(answers, capture_times_ns))
    return pandas.DataFrame(content, columns=list(COLUMNS))
