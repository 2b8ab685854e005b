# SPDX-License-Identifier: Apache-2.0
"""Frames out, answers in, by threads."""
from __future__ import annotations

import queue
import threading
import weakref
from types import TracebackType
from typing import Any, Callable, Iterable, Iterator, Optional, Tuple, Type

import grpc

from . import _convert
from ._resume import ResumableFrames, StreamOptions
from .errors import (
    Code,
    DeadlineExceededError,
    GroundlockError,
    StreamCancelledError,
    UnavailableError,
    error_of_call,
)
from .results import Answer, Frame, WatchUpdate

Metadata = Tuple[Tuple[str, str], ...]


class _Connection:
    """One call of Track."""

    def __init__(self) -> None:
        self.call: Any = None
        self.attached = False
        self.stop = False


class _Worker:
    """The thread that connects, and reads what comes. It holds no reference to
    the TrackingStream, so that one which is forgotten ends."""

    def __init__(
        self,
        track: Callable[..., Any],
        metadata: Metadata,
        server: str,
        frames: ResumableFrames,
    ) -> None:
        self.frames = frames
        self.changed = threading.Condition()
        self._track = track
        self._metadata = metadata
        self._server = server
        self._cancelled = False
        self._connection = _Connection()
        self._thread = threading.Thread(
            target=self._run, name="groundlock-stream", daemon=True
        )
        self._thread.start()

    def cancel(self) -> None:
        with self.changed:
            self._cancelled = True
            call = self._connection.call
            self.changed.notify_all()
        if call is not None:
            call.cancel()

    def join(self) -> None:
        self._thread.join()

    def _run(self) -> None:
        while True:
            error = self._connect()
            with self.changed:
                if self._cancelled:
                    self.frames.end(StreamCancelledError("the stream was cancelled"))
                if not self.frames.end_of_connection(error):
                    self.changed.notify_all()
                    return
                wait = self.frames.backoff_s()
                if wait is None:
                    self.changed.notify_all()
                    return
                self.changed.wait_for(lambda: self._cancelled, wait)

    def _connect(self) -> Optional[GroundlockError]:
        """One connection, from attaching to its end; what it ended with."""
        connection = _Connection()
        with self.changed:
            if self._cancelled:
                return None
            self._connection = connection
            attach = self.frames.attach_request()
            connection.call = self._track(
                self._requests(connection, attach), metadata=self._metadata
            )
        error: Optional[GroundlockError] = None
        try:
            first = next(connection.call, None)
            if first is None:
                error = UnavailableError("the connection was lost")
            else:
                with self.changed:
                    self.frames.attached(first)
                    connection.attached = True
                    self.changed.notify_all()
                for response in connection.call:
                    with self.changed:
                        self.frames.take(response)
                        self.changed.notify_all()
        except grpc.RpcError as call_error:
            error = error_of_call(call_error, self._server)
        except GroundlockError as local_error:
            # The server speaks what is not understood here; it would again.
            error = local_error
            with self.changed:
                self.frames.end(local_error)
        finally:
            with self.changed:
                connection.stop = True
                self.changed.notify_all()
            connection.call.cancel()
        return error

    def _requests(self, connection: _Connection, attach: Any) -> Iterator[Any]:
        """Run by gRPC's thread, which asks for the next message when the
        network has taken the previous one."""
        yield attach
        while True:
            with self.changed:
                self.changed.wait_for(
                    lambda: connection.stop
                    or (
                        connection.attached
                        and (self.frames.can_write or self.frames.closed)
                    )
                )
                if connection.stop or not self.frames.can_write:
                    return
                message = self.frames.next_to_write()
            yield message


class TrackingStream:
    """Sends frames to a session and receives their answers: one for every
    frame, in the order of the frames, across broken connections. After a break
    it reconnects with back-off, learns from the server which frames have
    arrived, has the answers that got lost on the way sent again and sends the
    frames that did not arrive once more.

    Thread-safe: one thread may send while another receives. A single one may do
    both in turns if it never has max_in_flight answers outstanding; `process`
    takes care of both. Made by Session.stream(); leaving its `with` ends it.
    """

    def __init__(
        self,
        track: Callable[..., Any],
        metadata: Metadata,
        server: str,
        session_id: str,
        options: StreamOptions,
    ) -> None:
        self._frames = ResumableFrames(session_id, options)
        self._worker = _Worker(track, metadata, server, self._frames)
        self._changed = self._worker.changed
        self._finalizer = weakref.finalize(self, _Worker.cancel, self._worker)
        try:
            with self._changed:
                self._changed.wait_for(
                    lambda: self._frames.attached_once or self._frames.over
                )
                if not self._frames.attached_once and self._frames.error:
                    raise self._frames.error
        except BaseException:
            self.cancel()
            raise

    @property
    def next_sequence(self) -> int:
        """The first sequence number that the server takes, as it said when the
        stream was opened: a client that was killed goes on from there."""
        return self._frames.first_sequence

    @property
    def num_reconnects(self) -> int:
        """How often the connection was lost and restored."""
        return self._frames.num_reconnects

    @property
    def in_flight(self) -> int:
        """Frames sent whose answer has not been taken."""
        with self._changed:
            return self._frames.in_flight

    def send(self, frame: Any, *, timeout_s: Optional[float] = None) -> int:
        """Hands over a Frame, or what Image.of takes; waits while max_in_flight
        are on the way. Returns its sequence number.

        DeadlineExceededError: there was no room in time, and the frame was not
        taken. Otherwise the reason for which the stream has ended
        (NotFoundError: the session is gone; AbortedError: another stream took
        over; UnavailableError: it could not be restored).
        """
        if not isinstance(frame, Frame):
            frame = Frame(frame)
        with self._changed:
            sequence, message = self._frames.prepare(frame)
            ready = self._changed.wait_for(
                lambda: self._frames.over
                or self._frames.closed
                or self._frames.has_room,
                timeout_s,
            )
            if not ready:
                raise DeadlineExceededError(
                    f"frame {sequence}: {self._frames.in_flight} frames are on the "
                    "way already; take their answers"
                )
            self._frames.check_open()
            self._frames.push(sequence, message)
            self._changed.notify_all()
        return sequence

    def close_send(self) -> None:
        """No more frames; receiving goes on with the outstanding answers."""
        with self._changed:
            self._frames.closed = True
            self._changed.notify_all()

    def receive(self, *, timeout_s: Optional[float] = None) -> Optional[Answer]:
        """The next answer, waiting for it; None after close_send() and the last
        answer. DeadlineExceededError: none came in time, and the stream goes
        on. Other errors end the stream."""
        with self._changed:
            ready = self._changed.wait_for(
                lambda: self._frames.over or self._frames.answers, timeout_s
            )
            if self._frames.answers:
                answer = self._frames.answers.popleft()
                self._changed.notify_all()  # there is room again
                return answer
            if not ready:
                raise DeadlineExceededError("no answer came in time")
            if self._frames.error is not None:
                raise self._frames.error
            return None

    def __iter__(self) -> Iterator[Answer]:
        """The answers, until close_send() and the last one."""
        while True:
            answer = self.receive()
            if answer is None:
                return
            yield answer

    def process(self, frames: Iterable[Any]) -> Iterator[Answer]:
        """Sends the frames from a thread of its own and yields the answers as
        they come. What `frames` raises is raised here, after the answers to the
        frames before it. Leaving the loop early ends the stream.
        """
        failure: "queue.SimpleQueue[BaseException]" = queue.SimpleQueue()

        def feed() -> None:
            try:
                for frame in frames:
                    self.send(frame)
            except BaseException as error:  # handed to the caller's thread
                failure.put(error)
            finally:
                self.close_send()

        feeder = threading.Thread(target=feed, name="groundlock-feed", daemon=True)
        feeder.start()
        done = False
        try:
            yield from self
            done = True
        finally:
            if not done:
                self.cancel()
        feeder.join()
        if not failure.empty():
            raise failure.get()

    def cancel(self) -> None:
        """Ends the stream at once; waiting calls raise StreamCancelledError.
        The session stays."""
        self._finalizer()
        self._worker.join()

    def __enter__(self) -> TrackingStream:
        return self

    def __exit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        self.cancel()


class Watcher:
    """Follows a session's results; made by Session.watch(). An iterator that
    ends when the session does. It does not reconnect: open another. One thread
    at a time; cancel() from any."""

    def __init__(self, call: Any, server: str) -> None:
        self._call = call
        self._server = server
        self._cancelled = False
        try:
            # Sent when the server watches; an error comes without.
            started = dict(call.initial_metadata() or ())
            if "groundlock-watching" not in started:
                next(call, None)  # raises what it ended with
                raise UnavailableError(f"{server}: the server does not watch")
        except grpc.RpcError as error:
            raise error_of_call(error, server) from None
        except BaseException:
            call.cancel()
            raise

    def __iter__(self) -> Iterator[WatchUpdate]:
        return self

    def __next__(self) -> WatchUpdate:
        try:
            return _convert.watch_from(next(self._call))
        except grpc.RpcError as call_error:
            error = error_of_call(call_error, self._server)
            # Deleted or expired: nothing is wrong with that.
            if error.code == Code.NOT_FOUND:
                raise StopIteration from None
            if self._cancelled:
                error = StreamCancelledError("the watch was cancelled")
            raise error from None

    def cancel(self) -> None:
        self._cancelled = True
        self._call.cancel()

    def __enter__(self) -> Watcher:
        return self

    def __exit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        self.cancel()
