# SPDX-License-Identifier: Apache-2.0
"""Images as they are sent: arrays as they are, or the bytes of a file."""
from __future__ import annotations

import enum
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional, Union

import numpy as np
from numpy.typing import NDArray

from .errors import DataLossError, FailedPreconditionError, bad_argument

ByteArray = NDArray[np.uint8]


class Encoding(enum.Enum):
    """How an image's bytes are to be read."""

    AUTO = "auto"  # JPEG or PNG, told by the bytes
    JPEG = "jpeg"
    PNG = "png"
    RAW_GRAY8 = "gray8"
    RAW_BGR8 = "bgr8"
    RAW_RGB8 = "rgb8"


_CHANNELS = {Encoding.RAW_GRAY8: 1, Encoding.RAW_BGR8: 3, Encoding.RAW_RGB8: 3}


def _pixels(image: Any, channels: int, field: str) -> ByteArray:
    array = np.asarray(image)
    shape = "(height, width)" if channels == 1 else "(height, width, 3)"
    if array.dtype != np.uint8:
        raise bad_argument(field, f"has dtype {array.dtype}, must be uint8")
    if channels == 1 and array.ndim == 3 and array.shape[2] == 1:
        array = array[:, :, 0]
    wanted = 2 if channels == 1 else 3
    if array.ndim != wanted or (wanted == 3 and array.shape[2] != 3):
        raise bad_argument(field, f"has shape {array.shape}, must be {shape}")
    if 0 in array.shape:
        raise bad_argument(field, f"has shape {array.shape}: there are no pixels")
    return np.ascontiguousarray(array)


@dataclass(frozen=True)
class Image:
    """An image's bytes. Made by `bgr`, `rgb`, `gray`, `file` or `jpeg`."""

    encoding: Encoding
    data: bytes
    width_px: int = 0  # raw encodings only
    height_px: int = 0  # raw encodings only

    @staticmethod
    def bgr(array: Any, *, field: str = "image") -> Image:
        """(height, width, 3) uint8 in OpenCV's order."""
        pixels = _pixels(array, 3, field)
        h, w = pixels.shape[:2]
        return Image(Encoding.RAW_BGR8, pixels.tobytes(), w, h)

    @staticmethod
    def rgb(array: Any, *, field: str = "image") -> Image:
        """(height, width, 3) uint8 in the order of Pillow and imageio."""
        pixels = _pixels(array, 3, field)
        h, w = pixels.shape[:2]
        return Image(Encoding.RAW_RGB8, pixels.tobytes(), w, h)

    @staticmethod
    def gray(array: Any, *, field: str = "image") -> Image:
        """(height, width) uint8."""
        pixels = _pixels(array, 1, field)
        h, w = pixels.shape
        return Image(Encoding.RAW_GRAY8, pixels.tobytes(), w, h)

    @staticmethod
    def file(source: Union[bytes, str, os.PathLike[str]]) -> Image:
        """A JPEG or PNG: its bytes, or its path. It is sent as it is; a
        rotation that EXIF asks for is not applied."""
        if isinstance(source, (bytes, bytearray, memoryview)):
            return Image(Encoding.AUTO, bytes(source))
        try:
            return Image(Encoding.AUTO, Path(source).read_bytes())
        except OSError as error:
            raise bad_argument(
                "image", f"{source}: cannot be read: {error.strerror}"
            ) from None

    @staticmethod
    def jpeg(array: Any, *, quality: int = 90, field: str = "image") -> Image:
        """Compresses an array in OpenCV's order: a tenth of the bytes on the
        wire, for some milliseconds here. Needs OpenCV or Pillow."""
        pixels = _pixels(array, 1 if np.ndim(array) == 2 else 3, field)
        cv2 = _module("cv2")
        if cv2 is not None:
            ok, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
            if ok:
                return Image(Encoding.JPEG, data.tobytes())
        pillow = _module("PIL.Image")
        if pillow is None:
            raise _no_codec("compress")
        import io

        out = io.BytesIO()
        ordered = pixels if pixels.ndim == 2 else pixels[:, :, ::-1]
        pillow.fromarray(np.ascontiguousarray(ordered)).save(
            out, "JPEG", quality=quality
        )
        return Image(Encoding.JPEG, out.getvalue())

    @staticmethod
    def of(value: Any, *, field: str = "image") -> Image:
        """An Image; an array: 2-D gray, 3-D in OpenCV's order (BGR); or the
        bytes or the path of a JPEG or PNG."""
        if isinstance(value, Image):
            return value
        if isinstance(value, (bytes, bytearray, memoryview, str, os.PathLike)):
            return Image.file(value)
        if isinstance(value, np.ndarray):
            return (Image.gray if value.ndim == 2 else Image.bgr)(value, field=field)
        raise bad_argument(
            field,
            f"{type(value).__name__} must be an Image, an array, or the bytes or "
            "path of a JPEG or PNG",
        )

    def to_array(self) -> ByteArray:
        """The pixels: (height, width) if gray, else (height, width, 3) in
        OpenCV's order. Compressed ones need OpenCV or Pillow."""
        channels = _CHANNELS.get(self.encoding)
        if channels is not None:
            if len(self.data) != channels * self.width_px * self.height_px:
                raise DataLossError(
                    f"image: {len(self.data)} bytes are not "
                    f"{self.width_px}x{self.height_px}x{channels}"
                )
            array = np.frombuffer(self.data, dtype=np.uint8)
            if channels == 1:
                return array.reshape(self.height_px, self.width_px)
            array = array.reshape(self.height_px, self.width_px, 3)
            return array[:, :, ::-1] if self.encoding is Encoding.RAW_RGB8 else array
        return _decode(self.data)


def _decode(data: bytes) -> ByteArray:
    cv2 = _module("cv2")
    if cv2 is not None:
        flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
        array = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
        if array is None:
            raise DataLossError("image: cannot be decoded")
        return np.asarray(array, dtype=np.uint8)
    pillow = _module("PIL.Image")
    if pillow is None:
        raise _no_codec("decode")
    import io

    try:
        rgb = np.asarray(pillow.open(io.BytesIO(data)).convert("RGB"))
    except Exception as error:  # Pillow has many kinds
        raise DataLossError(f"image: cannot be decoded: {error}") from None
    return np.asarray(rgb[:, :, ::-1], dtype=np.uint8)


def _module(name: str) -> Optional[Any]:
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError:
        return None


def _no_codec(verb: str) -> FailedPreconditionError:
    return FailedPreconditionError(
        f"to {verb} an image OpenCV or Pillow is needed (Debian: python3-opencv "
        "or python3-pil)"
    )
