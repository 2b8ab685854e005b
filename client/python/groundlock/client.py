# SPDX-License-Identifier: Apache-2.0
"""The plain client: calls wait, and streams have threads."""
from __future__ import annotations

import queue
import threading
from types import TracebackType
from typing import Any, Callable, Iterable, Iterator, List, Optional, Type, TypeVar, Union

import grpc

from . import _convert, _requests
from ._channel import (
    ClientOptions,
    HEALTH_CHECK,
    PathLike,
    check_server,
    make_calls,
    metadata,
    open_channel,
)
from ._files import ExportReceiver, Upload, find_build_files, find_import_files
from ._resume import StreamOptions
from .errors import Code, GroundlockError, UnavailableError, error_of_call
from .geometry import GeodeticPosition
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
from .stream import TrackingStream, Watcher
from .v1 import maps_pb2

T = TypeVar("T")

# How often a progress callback is called while the server works.
_POLL_S = 0.1


class Session:
    """A session on the server; made by Client.create_session() and
    Client.session(). Leaving its `with` deletes it."""

    def __init__(self, client: Client, session_id: str) -> None:
        self._client = client
        self.id = session_id

    def info(self) -> SessionInfo:
        """How it stands. NotFoundError: deleted or expired."""
        response = self._client._call("GetSession", _requests.get_session(self.id))
        return _convert.session_from(response.session)

    def set_target(
        self,
        target_id: str,
        box: Any,
        *,
        sequence: Optional[int] = None,
        body: Union[TargetBody, BodyKind, str, None] = None,
    ) -> str:
        """Marks a target by its box (x, y, width, height), px, in the frame
        `sequence`, not yet processed; None = the next that is. An empty id is
        made up by the server; an existing one is marked anew. body: what is known
        of it, or what kind it is of. Returns the id."""
        request = _requests.set_target(self.id, target_id, box, sequence, body)
        return str(self._client._call("SetTarget", request).target_id)

    def move_target(self, target_id: str, box: Any) -> None:
        """Says where a target is, without learning its appearance anew."""
        request = _requests.move_target(self.id, target_id, box)
        self._client._call("MoveTarget", request)

    def drop_target(self, target_id: str) -> None:
        self._client._call("DropTarget", _requests.drop_target(self.id, target_id))

    def stream(self, options: Optional[StreamOptions] = None) -> TrackingStream:
        """Opens the stream of frames. NotFoundError if the session is gone."""
        return TrackingStream(
            self._client._calls["Track"],
            self._client._metadata,
            self._client.server,
            self.id,
            options or StreamOptions(),
        )

    def track(
        self, frames: Iterable[Any], options: Optional[StreamOptions] = None
    ) -> Iterator[Answer]:
        """Streams the frames (Frame, or whatever Image.of takes), and yields
        one answer for each: see TrackingStream.process."""
        with self.stream(options) as stream:
            yield from stream.process(frames)

    def watch(
        self, *, include_images: bool = False, image_width_px: int = 0
    ) -> Watcher:
        """Follows the results of a session that somebody else feeds."""
        request = _requests.watch(self.id, include_images, image_width_px)
        call = self._client._calls["WatchSession"](
            request, metadata=self._client._metadata
        )
        return Watcher(call, self._client.server)

    def delete(self) -> None:
        """Ends it: its stream and watchers are closed."""
        self._client._call("DeleteSession", _requests.delete_session(self.id))

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        try:
            self.delete()
        except GroundlockError as failed:
            # What happened inside the `with` says more; so does a session that
            # has ended by itself.
            if error is None and failed.code != Code.NOT_FOUND:
                raise


class Client:
    """A connection to a server, shared by all calls. Thread-safe.

    server: HOST:PORT. Made here, or by groundlock.connect(), which also starts
    a server where none runs. Raises UnavailableError if nobody answers within
    connect_timeout_s. token: sent along with every call; over the network as it
    is, unless `tls` is given.
    """

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
        self._channel = open_channel(grpc, self.server, self.options)
        self._calls = make_calls(self._channel)
        try:
            self._wait_for_server()
        except BaseException:
            self._channel.close()
            raise

    def _wait_for_server(self) -> None:
        check = self._channel.unary_unary(HEALTH_CHECK)
        for wait in (True, False):
            try:
                check(
                    b"",
                    metadata=self._metadata,
                    timeout=self.options.connect_timeout_s,
                    wait_for_ready=wait,
                )
                return
            except grpc.RpcError as call_error:
                error = error_of_call(call_error, self.server)
                # The second time tells why there is no connection.
                silent = (Code.DEADLINE_EXCEEDED, Code.UNAVAILABLE)
                if error.code not in silent:
                    return
        raise UnavailableError(error.message)

    def close(self) -> None:
        """Ends all streams and the connection."""
        self._channel.close()
        if self._on_close is not None:
            on_close, self._on_close = self._on_close, None
            on_close()

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        self.close()

    def _call(self, method: str, request: Any, *, quick: bool = True) -> Any:
        """A unary call; quick ones have a deadline."""
        timeout = self.options.call_timeout_s if quick else None
        try:
            return self._calls[method](
                request, metadata=self._metadata, timeout=timeout
            )
        except grpc.RpcError as error:
            raise error_of_call(error, self.server) from None

    def caller(self) -> Caller:
        """Who this client is for the server, and what it may do."""
        return _convert.caller_from(self._call("GetCaller", _requests.get_caller()))

    # --- maps

    def import_map(
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
        """Uploads a reconstruction, and publishes it as the newest version.

        path: a folder with a COLMAP model (its database.db beside or above it),
        or the file or folder of another format. images: the folder of the
        images and their features, where they are not beside the model. align: a
        SimilarityTransform to metres with z up, or the path of an align.json;
        without it the ground is found by itself and becomes z = 0.
        """
        found = find_import_files(path, format, database, images)
        upload = Upload(found.files)
        header = _requests.import_header(
            name, found, _requests.alignment(align), origin, seed
        )
        last: Any = None
        for last in self._upload(
            "ImportMap", maps_pb2.ImportMapRequest, header, upload, on_progress
        ):
            pass
        return ImportReport(_convert.map_from(last.map), tuple(last.warnings))

    def build_map(
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
        """Builds a map of a video or of photos (a folder, or their paths), and
        publishes it. camera: the lens, or its camera.json; None = estimated.
        FailedPreconditionError says why they make no map, and what to do."""
        files, video_path = find_build_files(video, images)
        upload = Upload(files)
        header = _requests.build_header(
            name, files, video_path, camera, max_images, max_features, seed
        )
        result: Any = None
        for message in self._upload(
            "BuildMap", maps_pb2.BuildMapRequest, header, upload, on_progress
        ):
            if message.HasField("result"):
                result = message.result
            elif message.HasField("progress") and on_progress is not None:
                p = message.progress
                on_progress(Progress(p.stage, p.fraction, p.note))
        if result is None:
            raise UnavailableError("the server ended the build without a result")
        return _convert.build_report_from(result)

    def _upload(
        self,
        method: str,
        request: Any,
        header: Any,
        upload: Upload,
        on_progress: Optional[OnProgress],
    ) -> Iterator[Any]:
        """Sends the files and yields the responses. Progress is told from the
        caller's thread, until the first response."""
        responses: "queue.SimpleQueue[Any]" = queue.SimpleQueue()
        end = object()
        cancel: List[Any] = []

        def messages() -> Iterator[Any]:
            try:
                yield from upload.messages(request, header)
            except Exception as error:  # gRPC would only log it
                upload.error = error
                for handle in cancel:
                    handle.cancel()

        source = messages()
        call: Any = self._calls[method]
        import_call = method == "ImportMap"
        handle = (
            call.future(source, metadata=self._metadata)
            if import_call
            else call(source, metadata=self._metadata)
        )
        cancel.append(handle)
        if upload.error is not None:
            handle.cancel()

        def read() -> None:
            try:
                for response in [handle.result()] if import_call else handle:
                    responses.put(response)
                responses.put(end)
            except BaseException as error:
                responses.put(error)

        reader = threading.Thread(target=read, name="groundlock-upload", daemon=True)
        reader.start()
        answered = False
        try:
            while True:
                try:
                    item = responses.get(timeout=_POLL_S)
                except queue.Empty:
                    if on_progress is not None and not answered:
                        waiting = "importing" if import_call else "preparing"
                        on_progress(
                            upload.progress(waiting if upload.complete else "uploading")
                        )
                    continue
                if item is end:
                    return
                if isinstance(item, BaseException):
                    if upload.error is not None:
                        raise upload.error
                    if isinstance(item, grpc.RpcError):
                        raise error_of_call(item, self.server) from None
                    raise item
                answered = True
                yield item
        finally:
            handle.cancel()

    def list_maps(self) -> List[MapInfo]:
        """The newest version of every map, by name."""
        return _pages(
            lambda token: self._call("ListMaps", _requests.list_maps(token)),
            lambda page: [_convert.map_from(m) for m in page.maps],
        )

    def get_map(self, name: str, version: int = 0) -> MapInfo:
        """One map; version 0 is the newest."""
        response = self._call("GetMap", _requests.get_map(name, version))
        return _convert.map_from(response.map)

    def delete_map(self, name: str) -> None:
        """Removes all versions; running sessions keep theirs."""
        self._call("DeleteMap", _requests.delete_map(name))

    def check_map(self, name: str, version: int = 0) -> MapCheck:
        """Reads a stored map whole and says what is wrong with it."""
        response = self._call(
            "CheckMap", _requests.check_map(name, version), quick=False
        )
        known = response.HasField("map")
        info = _convert.map_from(response.map) if known else None
        return MapCheck(info, tuple(response.problems))

    def point_cloud(
        self, name: str, version: int = 0, *, max_points: int = 0
    ) -> PointCloud:
        """Landmarks and mapping images; max_points 0 = all, else an even
        subsample."""
        builder = _requests.CloudBuilder()
        request = _requests.point_cloud(name, version, max_points)
        try:
            for block in self._calls["GetPointCloud"](request, metadata=self._metadata):
                builder.take(block)
        except grpc.RpcError as error:
            raise error_of_call(error, self.server) from None
        return builder.cloud()

    def export_map(
        self,
        name: str,
        path: PathLike,
        *,
        format: Union[MapExportFormat, str] = MapExportFormat.COLMAP,
        version: int = 0,
        on_progress: Optional[OnProgress] = None,
    ) -> List[str]:
        """Writes a map as another tool's files: a folder for COLMAP, a file
        otherwise, which must not be there. Nothing is left on failure. Returns
        what the format could not express exactly."""
        request = _requests.export_map(name, version, format)
        with ExportReceiver(path, format) as receiver:
            call = self._calls["ExportMap"](request, metadata=self._metadata)
            try:
                for message in call:
                    receiver.take(message)
                    if on_progress is not None:
                        on_progress(receiver.progress())
            except grpc.RpcError as error:
                raise error_of_call(error, self.server) from None
            finally:
                call.cancel()
            receiver.place()
            return receiver.warnings

    def align_map(
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
        """Publishes a map in another world: metric, on Earth, on its ground; or
        (report_only) tells what it would be. method: see groundlock.maps.
        on_progress: called now and then while the server works."""
        request = _requests.align_map(
            name, method, origin, ground, version, seed, report_only
        )
        align: Any = self._calls["AlignMap"]
        call = align.future(request, metadata=self._metadata)
        try:
            while True:
                try:
                    return _convert.align_report_from(call.result(timeout=_POLL_S))
                except grpc.FutureTimeoutError:
                    if on_progress is not None:
                        on_progress(ALIGNING)
        except grpc.RpcError as error:
            raise error_of_call(error, self.server) from None
        finally:
            call.cancel()

    # --- sessions

    def create_session(
        self,
        *,
        map: Optional[str],
        camera: Any = None,
        options: Optional[SessionOptions] = None,
        session_id: str = "",
        map_version: int = 0,
    ) -> Session:
        """Makes a session. map: None = none, targets are tracked in 2D only.
        camera: a CameraModel, or the path of a camera.json; None = the map's
        own lens, scaled to the frames' size where they show the same picture.
        An empty session_id is made up by the server."""
        request = _requests.create_session(
            map, camera, options, session_id, map_version
        )
        response = self._call("CreateSession", request)
        return Session(self, response.session.session_id)

    def session(self, session_id: str) -> Session:
        """A session that is there already."""
        session = Session(self, session_id)
        session.info()
        return session

    def list_sessions(self) -> List[SessionInfo]:
        return _pages(
            lambda token: self._call("ListSessions", _requests.list_sessions(token)),
            lambda page: [_convert.session_from(s) for s in page.sessions],
        )

    def localize(
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
        """Finds the camera of a single image, without a session; image as
        Image.of takes it."""
        request = _requests.localize(
            image, map, camera, localizer, map_version, seed, prior
        )
        return _convert.localize_from(self._call("Localize", request, quick=False))


def _pages(
    fetch: Callable[[str], Any], parse: Callable[[Any], List[T]]
) -> List[T]:
    items: List[T] = []
    token = ""
    while True:
        page = fetch(token)
        items.extend(parse(page))
        token = page.next_page_token
        if not token:
            return items
