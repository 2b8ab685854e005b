# SPDX-License-Identifier: Apache-2.0
"""Frames of a video file, a folder of images, a stream or a camera.

Videos are decoded by ffmpeg as a child process: it is one small package where
OpenCV's Python module is hundreds of megabytes; it reads all that the command
line client reads; it tells when each frame was taken, which a video with gaps
needs; and a damaged file cannot take this process down. Pixels are as they are
stored: a rotation that the container asks for is not applied, since the lens
belongs to them.
"""
from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, IO, Iterator, List, Optional, Tuple, Type, Union

import numpy as np
from numpy.typing import NDArray

from ._files import _IMAGES, PathLike
from ._values import above_zero, integer
from .errors import (
    DataLossError,
    FailedPreconditionError,
    InvalidArgumentError,
    NotFoundError,
    UnavailableError,
    bad_argument,
)

_URL = re.compile(r"[a-z][a-z0-9+.-]*://")


@dataclass(frozen=True, eq=False)
class VideoFrame:
    """`image`: (height, width, 3) uint8, BGR; or the bytes of a folder's JPEG
    or PNG."""

    number: int  # 0-based, in the input
    capture_time_ns: int  # of a file: 0 at its first frame
    image: Union[NDArray[np.uint8], bytes]


class Video:
    """Frames of `source`: a video file, a folder of images (sorted by name), an
    rtsp:// or similar URL, or a V4L2 device. An iterator of VideoFrame; use as
    a context manager.

    fps: of a folder of images. first, last: frames [first, last) of the input.
    """

    def __init__(
        self,
        source: PathLike,
        *,
        fps: float = 25.0,
        first: int = 0,
        last: Optional[int] = None,
    ) -> None:
        self.source = os.fspath(source)
        self.fps = above_zero("fps", fps)
        self.first = integer("first", first)
        self.last = None if last is None else integer("last", last, self.first + 1)
        self.num_frames: Optional[int] = None  # as far as it is known beforehand
        is_url = _URL.match(self.source) is not None
        self.live = is_url or self.source.startswith("/dev/video")
        self._process: Optional["subprocess.Popen[bytes]"] = None
        self._errors: List[str] = []
        if not is_url and not os.path.exists(self.source):
            raise NotFoundError(f"video: {self.source}: no such file", field="video")
        if os.path.isdir(self.source):
            self._images = _image_files(Path(self.source))
            self.width_px, self.height_px = image_size(self._images[0])
            count = len(self._images)
            self.num_frames = max(0, min(count, self.last or count) - self.first)
        else:
            self._images = []
            self.width_px, self.height_px = self._probe()

    def __iter__(self) -> Iterator[VideoFrame]:
        frames = self._read_folder() if self._images else self._read_video()
        for frame in frames:
            if self.last is not None and frame.number >= self.last:
                return
            if frame.number >= self.first:
                yield frame

    def _read_folder(self) -> Iterator[VideoFrame]:
        for number, path in enumerate(self._images):
            if number < self.first:
                continue
            capture_time_ns = round(1e9 * number / self.fps)
            image: Union[NDArray[np.uint8], bytes]
            if path.suffix.lower() in (".jpg", ".jpeg", ".png"):
                image = path.read_bytes()
            else:
                image = _decode_still(path)
            yield VideoFrame(number, capture_time_ns, image)

    def _input(self) -> List[str]:
        if self.source.startswith("/dev/video"):
            return ["-f", "v4l2", "-i", self.source]
        if self.source.startswith("rtsp://"):
            return ["-rtsp_transport", "tcp", "-i", self.source]
        # A file whose name starts with a dash, or looks like a protocol.
        name = self.source if _URL.match(self.source) else f"file:{self.source}"
        return ["-i", name]

    def _probe(self) -> Tuple[int, int]:
        command = [
            _program("ffprobe"),
            "-v",
            "error",
            "-select_streams",
            "v:0",
            "-show_entries",
            "stream=width,height,nb_frames,avg_frame_rate",
            "-of",
            "json",
            *self._input(),
        ]
        done = subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL)
        streams = []
        if done.returncode == 0:
            streams = json.loads(done.stdout or b"{}").get("streams", [])
        if not streams or not streams[0].get("width"):
            why = done.stderr.decode(errors="replace").strip().splitlines()
            text = f"{self.source}: not readable as a video"
            if why:
                text += f": {why[-1]}"
            if self.live:
                raise UnavailableError(f"video: {text}")
            raise InvalidArgumentError(f"video: {text}", field="video")
        stream = streams[0]
        if str(stream.get("nb_frames", "")).isdigit():
            count = int(stream["nb_frames"])
            self.num_frames = max(0, min(count, self.last or count) - self.first)
        over, _, under = str(stream.get("avg_frame_rate", "")).partition("/")
        if over.isdigit() and under.isdigit() and int(over) and int(under):
            self.fps = int(over) / int(under)
        return int(stream["width"]), int(stream["height"])

    def _read_video(self) -> Iterator[VideoFrame]:
        times_read, times_write = os.pipe()
        # The time of each frame, ns, in ffmpeg's own form for machines; it is
        # written before the frame, so that neither waits for the other.
        filters = (
            "settb=1/1000000000,metadata=add:key=t:value=1,"
            f"metadata=print:key=t:direct=1:file=pipe\\\\:{times_write}"
        )
        command = [
            _program("ffmpeg"),
            *("-nostdin", "-v", "error", "-noautorotate"),
            *self._input(),
            *("-map", "0:v:0", "-an", "-sn", "-dn", "-vf", filters),
            *("-fps_mode", "passthrough", "-pix_fmt", "bgr24", "-f", "rawvideo", "-"),
        ]
        try:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                pass_fds=(times_write,),
            )
        finally:
            os.close(times_write)
        self._process = process
        assert process.stdout is not None and process.stderr is not None
        complaints = threading.Thread(
            target=self._drain, args=(process.stderr,), daemon=True
        )
        complaints.start()
        try:
            with os.fdopen(times_read, encoding="ascii", errors="replace") as times:
                yield from self._read_frames(process.stdout, _times(times))
            process.wait()
            complaints.join()
            if process.returncode != 0:
                why = self._errors[-1] if self._errors else f"{process.returncode}"
                raise DataLossError(f"video: {self.source}: ffmpeg ended: {why}")
        finally:
            self.close()

    def _read_frames(self, pixels: IO[bytes], times: Iterator[int]) -> Iterator[VideoFrame]:
        size = self.width_px * self.height_px * 3
        number, start, last = 0, 0, -1
        while True:
            data = pixels.read(size)
            if not data:
                return
            if len(data) != size:
                raise DataLossError(
                    f"video: {self.source}: frame {number} ends in its middle"
                )
            stamp = next(times, None)
            if self.live:
                capture_time_ns = time.monotonic_ns()
            else:
                if stamp is None:
                    stamp = last + round(1e9 / self.fps)
                if number == 0:
                    start = stamp
                capture_time_ns = stamp - start
            # Strictly increasing, also where a container says otherwise.
            capture_time_ns = max(capture_time_ns, last + 1)
            last = capture_time_ns
            array = np.frombuffer(data, dtype=np.uint8)
            image = array.reshape(self.height_px, self.width_px, 3)
            yield VideoFrame(number, capture_time_ns, image)
            number += 1

    def _drain(self, stream: IO[bytes]) -> None:
        with stream:
            for line in stream:
                text = line.decode(errors="replace").strip()
                if text:
                    self._errors = (self._errors + [text])[-5:]

    def close(self) -> None:
        """Ends the reading."""
        process, self._process = self._process, None
        if process is None:
            return
        if process.poll() is None:
            process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()

    def __enter__(self) -> Video:
        return self

    def __exit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        self.close()


def _times(lines: Any) -> Iterator[int]:
    """From lines like "frame:0    pts:41666667    pts_time:0.0416667"."""
    for line in lines:
        found = re.match(r"frame:\d+\s+pts:(-?\d+)", line)
        if found:
            yield int(found.group(1))


def _image_files(folder: Path) -> List[Path]:
    files = sorted(f for f in folder.iterdir() if f.suffix.lower() in _IMAGES)
    if not files:
        raise bad_argument("video", f"{folder}: holds no images")
    return files


def image_size(path: Path) -> Tuple[int, int]:
    """Width and height of an image file, px."""
    command = [
        _program("ffprobe"),
        *("-v", "error", "-select_streams", "v:0", "-show_entries"),
        *("stream=width,height", "-of", "csv=p=0", "-i", f"file:{path}"),
    ]
    done = subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL)
    parts = done.stdout.decode().strip().split(",")
    if done.returncode != 0 or len(parts) < 2:
        raise InvalidArgumentError(f"image: {path}: not readable as an image", field="image")
    return int(parts[0]), int(parts[1])


def _decode_still(path: Path) -> NDArray[np.uint8]:
    width, height = image_size(path)
    command = [
        _program("ffmpeg"),
        *("-nostdin", "-v", "error", "-noautorotate", "-i", f"file:{path}"),
        *("-frames:v", "1", "-pix_fmt", "bgr24", "-f", "rawvideo", "-"),
    ]
    done = subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL)
    if done.returncode != 0 or len(done.stdout) != width * height * 3:
        raise InvalidArgumentError(f"image: {path}: not readable as an image", field="image")
    array = np.frombuffer(done.stdout, dtype=np.uint8)
    return array.reshape(height, width, 3)


def _program(name: str) -> str:
    found = shutil.which(name)
    if found is None:
        raise FailedPreconditionError(f"{name} is not in PATH: install ffmpeg")
    return found
