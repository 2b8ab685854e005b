# SPDX-License-Identifier: Apache-2.0
"""Reads the recordings of the dashboard: MCAP files (https://mcap.dev/spec),
whole or interrupted. Topics: see the end of
proto/groundlock/dashboard/v1/dashboard.proto.

A file is a stranger's: every length is checked against the file before anything
is allocated, and what is damaged is a DataLossError that names the file and the
byte.
"""
from __future__ import annotations

import io
import os
import struct
import zlib
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from types import TracebackType
from typing import (
    Any,
    BinaryIO,
    Callable,
    Dict,
    FrozenSet,
    Iterable,
    Iterator,
    List,
    Optional,
    Tuple,
    Type,
)

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from . import _convert, _requests
from ._channel import PathLike
from .errors import DataLossError, FailedPreconditionError, GroundlockError, NotFoundError
from .images import Encoding, Image
from .maps import MapInfo, PointCloud
from .results import FrameResult, SessionInfo
from .v1 import maps_pb2, tracking_pb2

_MAGIC = b"\x89MCAP0\r\n"
_RECORD_HEADER = struct.Struct("<BQ")
_FOOTER_BYTES = _RECORD_HEADER.size + 20

# Larger than any chunk that is written: a message more than was asked for.
_MAX_CHUNK_BYTES = 1 << 27
_MAX_SUMMARY_BYTES = 1 << 28
_MAX_SMALL_RECORD_BYTES = 1 << 26

_FOOTER, _CHANNEL, _MESSAGE, _CHUNK = 0x02, 0x04, 0x05, 0x06
_CHUNK_INDEX, _DATA_END = 0x08, 0x0F

_INFO = "/session/info"
_MAP = "/session/map"
_POINTS = "/session/points"
_RESULT = "/session/result"
_IMAGE = "/session/image"


@dataclass(frozen=True)
class Message:
    """A message as it lies in the file."""

    topic: str
    log_time_ns: int  # the dashboard's wall clock
    publish_time_ns: int  # the frame's capture time
    data: bytes


@dataclass(frozen=True)
class RecordedImage:
    """The image of the result with the same capture time."""

    capture_time_ns: int
    image: Image


@dataclass(frozen=True)
class _Chunk:
    offset: int
    channels: Optional[FrozenSet[int]]  # None = not known


class _Fields:
    """Reads a record's content, little endian."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._at = 0

    def take(self, size: int) -> bytes:
        end = self._at + size
        if size < 0 or end > len(self._content):
            raise ValueError("a record ends before its last field")
        part = self._content[self._at : end]
        self._at = end
        return part

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")

    def text(self) -> str:
        return self.take(self.number(4)).decode("utf-8", errors="replace")

    def rest(self) -> bytes:
        return self.take(len(self._content) - self._at)


def _compressed_image() -> Any:
    """foxglove.CompressedImage, as far as it is needed: in a pool of its own,
    so that it does not meet another package's message of that name."""
    file = descriptor_pb2.FileDescriptorProto(
        name="groundlock_compressed_image.proto", package="foxglove", syntax="proto3"
    )
    message = file.message_type.add(name="CompressedImage")
    kinds = descriptor_pb2.FieldDescriptorProto
    for name, number, kind in (
        ("data", 2, kinds.TYPE_BYTES),
        ("format", 3, kinds.TYPE_STRING),
    ):
        message.field.add(
            name=name, number=number, type=kind, label=kinds.LABEL_OPTIONAL
        )
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    described = pool.FindMessageTypeByName("foxglove.CompressedImage")
    if hasattr(message_factory, "GetMessageClass"):
        return message_factory.GetMessageClass(described)
    return message_factory.MessageFactory(pool).GetPrototype(described)


_CompressedImage = _compressed_image()


class Recording:
    """A session in a file. Not thread-safe. Use as a context manager.

    complete: its writer has finished it. session, map: what was recorded.
    NotFoundError; DataLossError: this is no recording, or it is damaged.
    """

    def __init__(self, path: PathLike) -> None:
        self.path = Path(path)
        try:
            self._file: BinaryIO = open(self.path, "rb")
        except OSError as error:
            raise NotFoundError(f"{self.path}: {error.strerror}") from None
        self._size = os.fstat(self._file.fileno()).st_size
        self._channels: Dict[int, str] = {}
        self._chunks: List[_Chunk] = []
        self.complete = False
        try:
            if self._read(0, min(len(_MAGIC), self._size)) != _MAGIC:
                raise DataLossError(f"{self.path}: is no MCAP file")
            self.complete = self._read_summary()
            if not self.complete:
                self._scan()
            self.session, self.map = self._describe()
        except BaseException:
            self._file.close()
            raise

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        self.close()

    # --- what is in it

    def results(self) -> Iterator[FrameResult]:
        """The results, in the order of the file."""
        for message in self.messages([_RESULT]):
            parsed = self._parse(tracking_pb2.FrameResult, message)
            yield self._converted(_convert.result_from, parsed)

    def images(self) -> Iterator[RecordedImage]:
        """The images, in the order of the file."""
        for message in self.messages([_IMAGE]):
            parsed = self._parse(_CompressedImage, message)
            encoding = {"jpeg": Encoding.JPEG, "png": Encoding.PNG}.get(
                parsed.format, Encoding.AUTO
            )
            yield RecordedImage(message.publish_time_ns, Image(encoding, parsed.data))

    def point_cloud(self) -> PointCloud:
        """The subsample of the map that was recorded; empty if there is none."""
        builder = _requests.CloudBuilder()
        for message in self.messages([_POINTS]):
            parsed = self._parse(maps_pb2.GetPointCloudResponse, message)
            self._converted(builder.take, parsed)
        return builder.cloud()

    def start_time(self) -> Optional[datetime]:
        """When it begins, UTC."""
        first = next(iter(self.messages([_INFO])), None)
        if first is None:
            return None
        return datetime.fromtimestamp(1e-9 * first.log_time_ns, timezone.utc)

    def messages(self, topics: Optional[Iterable[str]] = None) -> Iterator[Message]:
        """The messages of these topics, None = all, in the order of the file.
        Chunks without them are not read where the file has its index."""
        wanted = None if topics is None else set(topics)
        for chunk in self._chunks:
            if wanted is not None and chunk.channels is not None:
                if not any(self._channels.get(c) in wanted for c in chunk.channels):
                    continue
            for opcode, content in self._records_of(chunk.offset):
                if opcode == _CHANNEL:
                    self._guarded(chunk.offset, self._take_channel, content)
                elif opcode == _MESSAGE:
                    message = self._guarded(chunk.offset, self._message, content)
                    if wanted is None or message.topic in wanted:
                        yield message

    def _describe(self) -> Tuple[SessionInfo, Optional[MapInfo]]:
        session, map_info = None, None
        for message in self.messages([_INFO, _MAP]):
            if message.topic == _INFO:
                parsed = self._parse(tracking_pb2.Session, message)
                session = self._converted(_convert.session_from, parsed)
            else:
                parsed = self._parse(maps_pb2.MapInfo, message)
                map_info = self._converted(_convert.map_from, parsed)
        if session is None:
            raise DataLossError(f"{self.path}: holds no session")
        return session, map_info

    def _parse(self, kind: Any, message: Message) -> Any:
        parsed = kind()
        try:
            parsed.ParseFromString(message.data)
        except DecodeError:
            raise DataLossError(
                f"{self.path}: a message of {message.topic} is damaged"
            ) from None
        return parsed

    def _converted(self, convert: Callable[[Any], Any], parsed: Any) -> Any:
        try:
            return convert(parsed)
        except (GroundlockError, ValueError, OverflowError, OSError) as error:
            raise DataLossError(f"{self.path}: a message is damaged: {error}") from None

    # --- bytes

    def _damaged(self, offset: int, why: object) -> DataLossError:
        return DataLossError(f"{self.path}: at byte {offset}: {why}")

    def _read(self, offset: int, size: int) -> bytes:
        if offset < 0 or size < 0 or offset + size > self._size:
            raise self._damaged(offset, "points behind the file's end")
        self._file.seek(offset)
        data = self._file.read(size)
        if len(data) != size:
            raise self._damaged(offset, "cannot be read")
        return data

    def _header(self, offset: int) -> Tuple[int, int]:
        """A record's opcode and the length of its content."""
        opcode, length = _RECORD_HEADER.unpack(self._read(offset, _RECORD_HEADER.size))
        return int(opcode), int(length)

    def _record(self, offset: int, limit: int) -> Tuple[int, bytes]:
        opcode, length = self._header(offset)
        if length > limit:
            raise self._damaged(offset, f"a record of {length} bytes is too large")
        return opcode, self._read(offset + _RECORD_HEADER.size, length)

    def _take_channel(self, content: bytes) -> None:
        fields = _Fields(content)
        number = fields.number(2)
        fields.number(2)  # schema
        self._channels[number] = fields.text()

    def _message(self, content: bytes) -> Message:
        fields = _Fields(content)
        topic = self._channels.get(fields.number(2), "")
        fields.number(4)  # sequence
        return Message(topic, fields.number(8), fields.number(8), fields.rest())

    def _read_summary(self) -> bool:
        """False: the file has no index."""
        tail = _FOOTER_BYTES + len(_MAGIC)
        if self._size < len(_MAGIC) + tail:
            return False
        end = self._read(self._size - tail, tail)
        opcode, length = _RECORD_HEADER.unpack(end[: _RECORD_HEADER.size])
        if not end.endswith(_MAGIC) or opcode != _FOOTER or length != 20:
            return False
        start = int.from_bytes(end[9:17], "little")
        stop = self._size - tail
        if start == 0:
            return False
        if start > stop or stop - start > _MAX_SUMMARY_BYTES:
            raise self._damaged(start, "the summary has an impossible size")
        for offset, opcode, content in self._split(self._read(start, stop - start), start):
            if opcode == _CHANNEL:
                self._guarded(offset, self._take_channel, content)
            elif opcode == _CHUNK_INDEX:
                self._chunks.append(self._guarded(offset, self._chunk_index, content))
        return True

    @staticmethod
    def _chunk_index(content: bytes) -> _Chunk:
        fields = _Fields(content)
        fields.take(16)  # first and last log time
        offset = fields.number(8)
        fields.take(8)  # the chunk's length
        index = _Fields(fields.take(fields.number(4)))
        channels = []
        try:
            while True:
                channels.append(index.number(2))
                index.take(8)
        except ValueError:
            pass  # its end
        return _Chunk(offset, frozenset(channels))

    def _guarded(self, offset: int, parse: Callable[[bytes], Any], content: bytes) -> Any:
        try:
            return parse(content)
        except ValueError as error:
            raise self._damaged(offset, error) from None

    def _split(self, data: bytes, start: int) -> Iterator[Tuple[int, int, bytes]]:
        """(offset, opcode, content) of the records that lie in `data`."""
        at = 0
        while at < len(data):
            if at + _RECORD_HEADER.size > len(data):
                raise self._damaged(start + at, "a record is cut off")
            opcode, length = _RECORD_HEADER.unpack_from(data, at)
            begin = at + _RECORD_HEADER.size
            if length > len(data) - begin:
                raise self._damaged(start + at, "a record is cut off")
            yield start + at, opcode, data[begin : begin + length]
            at = begin + length

    def _scan(self) -> None:
        """Goes through a file without an index, up to its last whole chunk."""
        at = len(_MAGIC)
        while at + _RECORD_HEADER.size <= self._size:
            opcode, length = self._header(at)
            if length > self._size - at - _RECORD_HEADER.size:
                return  # it broke off here
            if opcode == _CHUNK:
                self._chunks.append(_Chunk(at, None))
            elif opcode == _CHANNEL:
                _, content = self._record(at, _MAX_SMALL_RECORD_BYTES)
                self._guarded(at, self._take_channel, content)
            elif opcode in (_DATA_END, _FOOTER):
                return
            at += _RECORD_HEADER.size + length

    def _records_of(self, offset: int) -> Iterator[Tuple[int, bytes]]:
        opcode, content = self._record(offset, _MAX_CHUNK_BYTES)
        if opcode != _CHUNK:
            raise self._damaged(offset, "is no chunk")
        records = self._guarded(offset, self._uncompressed, content)
        for _, opcode, record in self._split(records, offset):
            yield opcode, record

    @staticmethod
    def _uncompressed(content: bytes) -> bytes:
        fields = _Fields(content)
        fields.take(16)  # first and last log time
        size = fields.number(8)
        crc = fields.number(4)
        compression = fields.text()
        records = fields.take(fields.number(8))
        if size > _MAX_CHUNK_BYTES:
            raise ValueError(f"a chunk of {size} bytes is too large")
        if compression == "zstd":
            records = _decompress(records, size)
        elif compression:
            raise ValueError(f"compression {compression!r} is not known; zstd or none")
        if len(records) != size:
            raise ValueError(f"a chunk holds {len(records)} bytes, {size} promised")
        if crc and zlib.crc32(records) != crc:
            raise ValueError("a chunk's checksum is wrong")
        return records


def _decompress(data: bytes, size: int) -> bytes:
    try:
        import zstandard
    except ImportError:
        raise FailedPreconditionError(
            "this recording is compressed: reading it needs zstandard (Debian: "
            "python3-zstandard)"
        ) from None
    try:
        decompressor = zstandard.ZstdDecompressor(max_window_size=_MAX_CHUNK_BYTES)
        with decompressor.stream_reader(io.BytesIO(data)) as reader:
            # By its own word, not by the stream's, which could be anything.
            return bytes(reader.read(size + 1))
    except zstandard.ZstdError as error:
        raise ValueError(f"a chunk cannot be decompressed: {error}") from None
