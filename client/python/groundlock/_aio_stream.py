# SPDX-License-Identifier: Apache-2.0
"""Frames out, answers in, by asyncio; see stream for the words' meaning."""
from __future__ import annotations

import asyncio
from types import TracebackType
from typing import (
    Any,
    AsyncIterable,
    AsyncIterator,
    Callable,
    Iterable,
    Optional,
    Tuple,
    Type,
    Union,
)

import grpc
import grpc.aio

from . import _convert
from ._resume import ResumableFrames, StreamOptions
from .errors import (
    Code,
    DeadlineExceededError,
    GroundlockError,
    StreamCancelledError,
    UnavailableError,
    error_of,
    error_of_call,
)
from .results import Answer, Frame, WatchUpdate

Metadata = Tuple[Tuple[str, str], ...]
Frames = Union[AsyncIterable[Any], Iterable[Any]]

_END = object()


async def each(items: Frames) -> AsyncIterator[Any]:
    """Of either kind; a plain one is asked from a thread, since it may wait."""
    if isinstance(items, AsyncIterable):
        async for item in items:
            yield item
        return
    iterator = iter(items)
    loop = asyncio.get_running_loop()
    while True:
        item = await loop.run_in_executor(None, next, iterator, _END)
        if item is _END:
            return
        yield item


async def status_of(call: Any, server: str) -> Optional[GroundlockError]:
    """What a call has ended with; None if in good order."""
    code = await call.code()
    if code is grpc.StatusCode.OK:
        return None
    message = await call.details() or code.name.lower()
    number = int(code.value[0])
    if number == Code.UNAVAILABLE:
        message = f"{server}: {message} (is groundlock-server running there?)"
    return error_of(number, message)


class AsyncTrackingStream:
    """As TrackingStream. Made by `await AsyncSession.stream()`."""

    def __init__(
        self,
        track: Callable[..., Any],
        metadata: Metadata,
        server: str,
        session_id: str,
        options: StreamOptions,
    ) -> None:
        self._track = track
        self._metadata = metadata
        self._server = server
        self._frames = ResumableFrames(session_id, options)
        self._changed = asyncio.Condition()
        self._task = asyncio.ensure_future(self._run())

    async def _open(self) -> AsyncTrackingStream:
        try:
            async with self._changed:
                await self._changed.wait_for(
                    lambda: self._frames.attached_once or self._frames.over
                )
            if not self._frames.attached_once and self._frames.error:
                raise self._frames.error
        except BaseException:
            await self.cancel()
            raise
        return self

    @property
    def next_sequence(self) -> int:
        return self._frames.first_sequence

    @property
    def num_reconnects(self) -> int:
        return self._frames.num_reconnects

    @property
    def in_flight(self) -> int:
        return self._frames.in_flight

    async def send(self, frame: Any, *, timeout_s: Optional[float] = None) -> int:
        """Hands over a frame; waits while max_in_flight are on the way. One
        task at a time. Returns its sequence number."""
        if not isinstance(frame, Frame):
            frame = Frame(frame)
        sequence, message = self._frames.prepare(frame)
        frames = self._frames
        if not await self._wait(
            lambda: frames.over or frames.closed or frames.has_room, timeout_s
        ):
            raise DeadlineExceededError(
                f"frame {sequence}: {frames.in_flight} frames are on the way "
                "already; take their answers"
            )
        frames.check_open()
        frames.push(sequence, message)
        await self._notify()
        return sequence

    async def close_send(self) -> None:
        """No more frames; receiving goes on with the outstanding answers."""
        self._frames.closed = True
        await self._notify()

    async def receive(self, *, timeout_s: Optional[float] = None) -> Optional[Answer]:
        """The next answer; None after close_send() and the last one."""
        frames = self._frames
        ready = await self._wait(lambda: frames.over or bool(frames.answers), timeout_s)
        if frames.answers:
            answer = frames.answers.popleft()
            await self._notify()  # there is room again
            return answer
        if not ready:
            raise DeadlineExceededError("no answer came in time")
        if frames.error is not None:
            raise frames.error
        return None

    async def __aiter__(self) -> AsyncIterator[Answer]:
        while True:
            answer = await self.receive()
            if answer is None:
                return
            yield answer

    async def process(self, frames: Frames) -> AsyncIterator[Answer]:
        """Sends the frames from a task of its own and yields the answers as
        they come; what `frames` raises is raised after the answers to the
        frames before it."""

        async def feed() -> None:
            try:
                async for frame in each(frames):
                    await self.send(frame)
            finally:
                await self.close_send()

        feeder = asyncio.ensure_future(feed())
        try:
            async for answer in self:
                yield answer
            await feeder
        finally:
            feeder.cancel()
            await asyncio.gather(feeder, return_exceptions=True)

    async def cancel(self) -> None:
        """Ends the stream at once; the session stays."""
        self._frames.end(StreamCancelledError("the stream was cancelled"))
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        await self._notify()

    async def __aenter__(self) -> AsyncTrackingStream:
        return self

    async def __aexit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        await self.cancel()

    # --- the connection

    async def _wait(
        self, predicate: Callable[[], bool], timeout_s: Optional[float]
    ) -> bool:
        async def wait() -> None:
            async with self._changed:
                await self._changed.wait_for(predicate)

        if predicate():
            return True
        try:
            await asyncio.wait_for(wait(), timeout_s)
        except asyncio.TimeoutError:
            return predicate()
        return True

    async def _notify(self) -> None:
        async with self._changed:
            self._changed.notify_all()

    async def _run(self) -> None:
        try:
            while True:
                error = await self._connect()
                if not self._frames.end_of_connection(error):
                    return
                wait = self._frames.backoff_s()
                if wait is None:
                    return
                await asyncio.sleep(wait)
        finally:
            self._frames.end(StreamCancelledError("the stream was cancelled"))
            await self._notify()

    async def _connect(self) -> Optional[GroundlockError]:
        """One connection, from attaching to its end; what it ended with."""
        call = self._track(metadata=self._metadata)
        writer: Optional["asyncio.Future[None]"] = None
        try:
            await call.write(self._frames.attach_request())
            first = await call.read()
            if first is not grpc.aio.EOF:
                self._frames.attached(first)
                await self._notify()
                writer = asyncio.ensure_future(self._write(call))
                while True:
                    response = await call.read()
                    if response is grpc.aio.EOF:
                        break
                    self._frames.take(response)
                    await self._notify()
            ended = await status_of(call, self._server)
            if ended is None and writer is None:
                ended = UnavailableError("the connection was lost")
            return ended
        except grpc.RpcError as call_error:
            return error_of_call(call_error, self._server)
        except asyncio.InvalidStateError:  # written to after its end
            return await status_of(call, self._server)
        except GroundlockError as local_error:
            # The server speaks what is not understood here; it would again.
            self._frames.end(local_error)
            return local_error
        finally:
            call.cancel()
            if writer is not None:
                writer.cancel()
                await asyncio.gather(writer, return_exceptions=True)

    async def _write(self, call: Any) -> None:
        frames = self._frames
        try:
            while True:
                await self._wait(lambda: frames.can_write or frames.closed, None)
                if not frames.can_write:
                    await call.done_writing()
                    return
                await call.write(frames.next_to_write())
        except (grpc.RpcError, asyncio.InvalidStateError):
            pass  # the reader finds out why


class AsyncWatcher:
    """As Watcher: `async for update in await session.watch()`."""

    def __init__(self, call: Any, server: str) -> None:
        self._call = call
        self._server = server

    async def _open(self) -> AsyncWatcher:
        try:
            started = await self._call.initial_metadata() or ()
            # gRPC's own mapping goes through pairs.
            if not any(key == "groundlock-watching" for key, _ in started):
                error = await status_of(self._call, self._server)
                raise error or UnavailableError(
                    f"{self._server}: the server does not watch"
                )
        except grpc.RpcError as call_error:
            raise error_of_call(call_error, self._server) from None
        except BaseException:
            self._call.cancel()
            raise
        return self

    def __aiter__(self) -> AsyncWatcher:
        return self

    async def __anext__(self) -> WatchUpdate:
        try:
            response = await self._call.read()
        except grpc.RpcError as call_error:
            error = error_of_call(call_error, self._server)
            # Deleted or expired: nothing is wrong with that.
            if error.code == Code.NOT_FOUND:
                raise StopAsyncIteration from None
            raise error from None
        if response is grpc.aio.EOF:
            raise StopAsyncIteration
        return _convert.watch_from(response)

    def cancel(self) -> None:
        self._call.cancel()

    async def __aenter__(self) -> AsyncWatcher:
        return self

    async def __aexit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        self.cancel()
