# SPDX-License-Identifier: Apache-2.0
"""The asyncio client: the calls of groundlock.Client, awaited. The arguments,
results and errors are the same; so are the words that describe them there."""
from __future__ import annotations

import asyncio
import time
from types import TracebackType
from typing import Any, AsyncIterator, Callable, Iterable, List, Optional, Type, Union

import grpc
import grpc.aio

from . import _convert, _requests
from ._aio_stream import AsyncTrackingStream, AsyncWatcher, Frames, status_of
from ._channel import (
    ClientOptions,
    HEALTH_CHECK,
    PathLike,
    TLS,
    check_server,
    find_token,
    make_calls,
    metadata,
    open_channel,
)
from ._files import ExportReceiver, Upload, find_build_files, find_import_files
from ._resume import StreamOptions
from .errors import Code, GroundlockError, UnavailableError, error_of_call
from .geometry import GeodeticPosition
from .local_server import choose_server
from .maps import (
    ALIGNING,
    AlignMethod,
    AlignReport,
    BuildReport,
    Ground,
    ImportReport,
    MapCheck,
    MapExportFormat,
    MapFormat,
    MapInfo,
    OnProgress,
    PointCloud,
    Progress,
)
from .results import (
    Answer,
    BodyKind,
    Caller,
    LocalizeReport,
    PosePrior,
    SessionInfo,
    SessionOptions,
    TargetBody,
)
from .v1 import maps_pb2

__all__ = [
    "AsyncClient",
    "AsyncSession",
    "AsyncTrackingStream",
    "AsyncWatcher",
    "connect",
]

# How often a progress callback is called while the server works.
_POLL_S = 0.1


class AsyncSession:
    """As Session; leaving its `async with` deletes it."""

    def __init__(self, client: AsyncClient, session_id: str) -> None:
        self._client = client
        self.id = session_id

    async def info(self) -> SessionInfo:
        request = _requests.get_session(self.id)
        response = await self._client._call("GetSession", request)
        return _convert.session_from(response.session)

    async def set_target(
        self,
        target_id: str,
        box: Any,
        *,
        sequence: Optional[int] = None,
        body: Union[TargetBody, BodyKind, str, None] = None,
    ) -> str:
        request = _requests.set_target(self.id, target_id, box, sequence, body)
        return str((await self._client._call("SetTarget", request)).target_id)

    async def move_target(self, target_id: str, box: Any) -> None:
        request = _requests.move_target(self.id, target_id, box)
        await self._client._call("MoveTarget", request)

    async def drop_target(self, target_id: str) -> None:
        request = _requests.drop_target(self.id, target_id)
        await self._client._call("DropTarget", request)

    async def stream(
        self, options: Optional[StreamOptions] = None
    ) -> AsyncTrackingStream:
        return await AsyncTrackingStream(
            self._client._calls["Track"],
            self._client._metadata,
            self._client.server,
            self.id,
            options or StreamOptions(),
        )._open()

    async def track(
        self, frames: Frames, options: Optional[StreamOptions] = None
    ) -> AsyncIterator[Answer]:
        """frames: an iterable, which is then asked from a thread, or an
        asynchronous one."""
        async with await self.stream(options) as stream:
            async for answer in stream.process(frames):
                yield answer

    async def watch(
        self, *, include_images: bool = False, image_width_px: int = 0
    ) -> AsyncWatcher:
        request = _requests.watch(self.id, include_images, image_width_px)
        call = self._client._calls["WatchSession"](
            request, metadata=self._client._metadata
        )
        return await AsyncWatcher(call, self._client.server)._open()

    async def delete(self) -> None:
        await self._client._call("DeleteSession", _requests.delete_session(self.id))

    async def __aenter__(self) -> AsyncSession:
        return self

    async def __aexit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        try:
            await self.delete()
        except GroundlockError as failed:
            if error is None and failed.code != Code.NOT_FOUND:
                raise


class AsyncClient:
    """As Client; of the event loop in which it is made, by connect()."""

    def __init__(
        self,
        server: str,
        options: Optional[ClientOptions] = None,
        *,
        on_close: Optional[Callable[[], None]] = None,
    ) -> None:
        self.server, self.options = check_server(server, options)
        self._metadata = metadata(self.options)
        self._on_close = on_close
        self._channel = open_channel(grpc.aio, self.server, self.options)
        self._calls = make_calls(self._channel)

    async def _wait_for_server(self) -> None:
        check = self._channel.unary_unary(HEALTH_CHECK)
        for wait in (True, False):
            try:
                await check(
                    b"",
                    metadata=self._metadata,
                    timeout=self.options.connect_timeout_s,
                    wait_for_ready=wait,
                )
                return
            except grpc.RpcError as call_error:
                error = error_of_call(call_error, self.server)
                # The second time tells why there is no connection.
                if error.code not in (Code.DEADLINE_EXCEEDED, Code.UNAVAILABLE):
                    return
        raise UnavailableError(error.message)

    async def close(self) -> None:
        await self._channel.close()
        if self._on_close is not None:
            on_close, self._on_close = self._on_close, None
            await asyncio.get_running_loop().run_in_executor(None, on_close)

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        await self.close()

    async def _call(self, method: str, request: Any, *, quick: bool = True) -> Any:
        timeout = self.options.call_timeout_s if quick else None
        try:
            return await self._calls[method](
                request, metadata=self._metadata, timeout=timeout
            )
        except grpc.RpcError as error:
            raise error_of_call(error, self.server) from None

    async def caller(self) -> Caller:
        response = await self._call("GetCaller", _requests.get_caller())
        return _convert.caller_from(response)

    # --- maps

    async def import_map(
        self,
        name: str,
        path: PathLike,
        *,
        format: Union[MapFormat, str] = MapFormat.AUTO,
        database: Optional[PathLike] = None,
        images: Optional[PathLike] = None,
        align: Any = None,
        origin: Optional[GeodeticPosition] = None,
        seed: int = 0,
        on_progress: Optional[OnProgress] = None,
    ) -> ImportReport:
        found = find_import_files(path, format, database, images)
        upload = Upload(found.files)
        header = _requests.import_header(
            name, found, _requests.alignment(align), origin, seed
        )
        call = self._calls["ImportMap"](metadata=self._metadata)
        try:
            await self._send(call, maps_pb2.ImportMapRequest, header, upload, on_progress)
            # The call is the future of its response.
            response = await _ticking(
                call, lambda: upload.progress("importing"), on_progress
            )
        except grpc.RpcError as error:
            raise error_of_call(error, self.server) from None
        finally:
            call.cancel()
        return ImportReport(_convert.map_from(response.map), tuple(response.warnings))

    async def build_map(
        self,
        name: str,
        *,
        video: Optional[PathLike] = None,
        images: Union[PathLike, Iterable[PathLike], None] = None,
        camera: Any = None,
        max_images: int = 0,
        max_features: int = 0,
        seed: int = 0,
        on_progress: Optional[OnProgress] = None,
    ) -> BuildReport:
        files, video_path = find_build_files(video, images)
        upload = Upload(files)
        header = _requests.build_header(
            name, files, video_path, camera, max_images, max_features, seed
        )
        call = self._calls["BuildMap"](metadata=self._metadata)
        result: Any = None
        try:
            await self._send(call, maps_pb2.BuildMapRequest, header, upload, on_progress)
            while True:
                message = await call.read()
                if message is grpc.aio.EOF:
                    break
                if message.HasField("result"):
                    result = message.result
                elif message.HasField("progress") and on_progress is not None:
                    p = message.progress
                    on_progress(Progress(p.stage, p.fraction, p.note))
            error = await status_of(call, self.server)
            if error is not None:
                raise error
        except grpc.RpcError as call_error:
            raise error_of_call(call_error, self.server) from None
        finally:
            call.cancel()
        if result is None:
            raise UnavailableError("the server ended the build without a result")
        return _convert.build_report_from(result)

    async def _send(
        self,
        call: Any,
        request: Any,
        header: Any,
        upload: Upload,
        on_progress: Optional[OnProgress],
    ) -> None:
        """Sends the files; returns early if the server has stopped listening,
        since its own status says why."""
        loop = asyncio.get_running_loop()
        messages = upload.messages(request, header)
        told = time.monotonic()
        try:
            while True:
                message = await loop.run_in_executor(None, next, messages, None)
                if message is None:
                    break
                await call.write(message)
                if on_progress is not None and time.monotonic() - told > _POLL_S:
                    told = time.monotonic()
                    on_progress(upload.progress())
            await call.done_writing()
        except (grpc.RpcError, asyncio.InvalidStateError):
            pass

    async def list_maps(self) -> List[MapInfo]:
        maps: List[MapInfo] = []
        token = ""
        while True:
            page = await self._call("ListMaps", _requests.list_maps(token))
            maps.extend(_convert.map_from(m) for m in page.maps)
            token = page.next_page_token
            if not token:
                return maps

    async def get_map(self, name: str, version: int = 0) -> MapInfo:
        response = await self._call("GetMap", _requests.get_map(name, version))
        return _convert.map_from(response.map)

    async def delete_map(self, name: str) -> None:
        await self._call("DeleteMap", _requests.delete_map(name))

    async def check_map(self, name: str, version: int = 0) -> MapCheck:
        request = _requests.check_map(name, version)
        response = await self._call("CheckMap", request, quick=False)
        known = response.HasField("map")
        info = _convert.map_from(response.map) if known else None
        return MapCheck(info, tuple(response.problems))

    async def point_cloud(
        self, name: str, version: int = 0, *, max_points: int = 0
    ) -> PointCloud:
        builder = _requests.CloudBuilder()
        request = _requests.point_cloud(name, version, max_points)
        try:
            async for block in self._calls["GetPointCloud"](
                request, metadata=self._metadata
            ):
                builder.take(block)
        except grpc.RpcError as error:
            raise error_of_call(error, self.server) from None
        return builder.cloud()

    async def export_map(
        self,
        name: str,
        path: PathLike,
        *,
        format: Union[MapExportFormat, str] = MapExportFormat.COLMAP,
        version: int = 0,
        on_progress: Optional[OnProgress] = None,
    ) -> List[str]:
        request = _requests.export_map(name, version, format)
        with ExportReceiver(path, format) as receiver:
            call = self._calls["ExportMap"](request, metadata=self._metadata)
            try:
                async for message in call:
                    receiver.take(message)
                    if on_progress is not None:
                        on_progress(receiver.progress())
            except grpc.RpcError as error:
                raise error_of_call(error, self.server) from None
            finally:
                call.cancel()
            receiver.place()
            return receiver.warnings

    async def align_map(
        self,
        name: str,
        method: AlignMethod = None,
        *,
        origin: Optional[GeodeticPosition] = None,
        ground: Ground = None,
        version: int = 0,
        seed: int = 0,
        report_only: bool = False,
        on_progress: Optional[OnProgress] = None,
    ) -> AlignReport:
        request = _requests.align_map(
            name, method, origin, ground, version, seed, report_only
        )
        call = self._calls["AlignMap"](request, metadata=self._metadata)
        try:
            response = await _ticking(call, lambda: ALIGNING, on_progress)
        except grpc.RpcError as error:
            raise error_of_call(error, self.server) from None
        finally:
            call.cancel()
        return _convert.align_report_from(response)

    # --- sessions

    async def create_session(
        self,
        *,
        map: Optional[str],
        camera: Any = None,
        options: Optional[SessionOptions] = None,
        session_id: str = "",
        map_version: int = 0,
    ) -> AsyncSession:
        request = _requests.create_session(
            map, camera, options, session_id, map_version
        )
        response = await self._call("CreateSession", request)
        return AsyncSession(self, response.session.session_id)

    async def session(self, session_id: str) -> AsyncSession:
        session = AsyncSession(self, session_id)
        await session.info()
        return session

    async def list_sessions(self) -> List[SessionInfo]:
        sessions: List[SessionInfo] = []
        token = ""
        while True:
            page = await self._call("ListSessions", _requests.list_sessions(token))
            sessions.extend(_convert.session_from(s) for s in page.sessions)
            token = page.next_page_token
            if not token:
                return sessions

    async def localize(
        self,
        image: Any,
        *,
        map: str,
        camera: Any = None,
        localizer: str = "",
        map_version: int = 0,
        seed: int = 0,
        prior: Optional[PosePrior] = None,
    ) -> LocalizeReport:
        request = _requests.localize(
            image, map, camera, localizer, map_version, seed, prior
        )
        return _convert.localize_from(await self._call("Localize", request, quick=False))


async def _ticking(
    call: Any, progress: Callable[[], Progress], on_progress: Optional[OnProgress]
) -> Any:
    """Waits for a call's response, and tells now and then that it does."""

    async def response() -> Any:
        return await call

    task = asyncio.ensure_future(response())
    try:
        while not (await asyncio.wait({task}, timeout=_POLL_S))[0]:
            if on_progress is not None:
                on_progress(progress())
        return task.result()
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def connect(
    server: Optional[str] = None,
    *,
    local: bool = False,
    token: Optional[str] = None,
    token_file: Optional[PathLike] = None,
    tls: Optional[TLS] = None,
    connect_timeout_s: float = 5.0,
    call_timeout_s: float = 30.0,
) -> AsyncClient:
    """As groundlock.connect()."""
    if token is None:
        token = find_token(token_file)
    options = ClientOptions(token, tls, connect_timeout_s, call_timeout_s)
    loop = asyncio.get_running_loop()
    address, own = await loop.run_in_executor(None, choose_server, server, local, tls)
    client = AsyncClient(address, options, on_close=own.close if own else None)
    try:
        await client._wait_for_server()
    except BaseException:
        await client.close()
        raise
    return client
