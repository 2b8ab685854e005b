# SPDX-License-Identifier: Apache-2.0
"""What a stream of frames knows across broken connections: which frames have no
answer yet, which of them are on their way, and how to go on. Neither threads
nor sockets: the plain and the asyncio stream drive it, one thread at a time.

The rules are those of docs/api.md, "Resuming", as the C++ client keeps them.
"""
from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass
from typing import Any, Deque, Optional, Tuple

from . import _convert
from ._values import above_zero, identifier, integer, number
from .errors import (
    Code,
    DataLossError,
    FailedPreconditionError,
    GroundlockError,
    InternalError,
    UnavailableError,
    bad_argument,
)
from .results import Answer, Frame, FrameFailed
from .v1 import tracking_pb2

_UINT64_MAX = (1 << 64) - 1

# After these another attempt could bring something else.
_TRANSIENT = frozenset(
    (
        Code.UNAVAILABLE,
        Code.CANCELLED,
        Code.UNKNOWN,
        Code.INTERNAL,
        Code.DEADLINE_EXCEEDED,
    )
)


def is_transient(error: GroundlockError) -> bool:
    return error.code in _TRANSIENT


@dataclass(frozen=True)
class StreamOptions:
    """How a stream of frames behaves.

    max_in_flight: frames that may be on the way, sent and their answer not yet
    taken; sending waits when it is reached. Reconnecting: waits between
    attempts grow from the first to the last backoff, and the stream gives up
    when it could not be restored for give_up_after_s.
    """

    max_in_flight: int = 16
    first_backoff_s: float = 0.1
    last_backoff_s: float = 5.0
    give_up_after_s: float = 60.0

    def __post_init__(self) -> None:
        # The server keeps 256 answers to be sent again.
        integer("max_in_flight", self.max_in_flight, 1, 256)
        above_zero("first_backoff_s", self.first_backoff_s)
        if number("last_backoff_s", self.last_backoff_s) < self.first_backoff_s:
            raise bad_argument(
                "last_backoff_s",
                f"{self.last_backoff_s!r} must not be below first_backoff_s, "
                f"{self.first_backoff_s!r}",
            )
        if number("give_up_after_s", self.give_up_after_s) < 0.0:
            raise bad_argument(
                "give_up_after_s", f"{self.give_up_after_s!r} must not be negative"
            )


class ResumableFrames:
    """The state of one stream."""

    def __init__(self, session_id: str, options: StreamOptions) -> None:
        self.session_id = identifier("session_id", session_id)
        self.options = options
        self.answers: Deque[Answer] = deque()  # not yet taken by the caller
        self.num_reconnects = 0
        self.attached_once = False
        self.closed = False  # no more frames will come
        self.over = False
        self.error: Optional[GroundlockError] = None  # why it is over
        self.first_sequence = 0
        self._next_sequence = 0
        # (sequence, message) without an answer, in order; the first
        # _num_written are on their way on the present connection, or with the
        # server since an earlier one.
        self._unanswered: Deque[Tuple[int, Any]] = deque()
        self._num_written = 0
        self._connected = False
        self._attempt = 0
        self._give_up_at = time.monotonic() + options.give_up_after_s
        self._last_error: GroundlockError = UnavailableError("not connected yet")

    # --- the caller's side

    @property
    def in_flight(self) -> int:
        return len(self._unanswered) + len(self.answers)

    @property
    def has_room(self) -> bool:
        return self.in_flight < self.options.max_in_flight

    def check_open(self) -> None:
        """Raises why no frame can be sent any more."""
        if self.over:
            raise self.error or FailedPreconditionError("the stream has ended")
        if self.closed:
            raise FailedPreconditionError("frames were declared complete")

    def prepare(self, frame: Frame) -> Tuple[int, Any]:
        """Checks and numbers a frame; says nothing about room."""
        sequence = self._next_sequence
        if frame.sequence is not None:
            sequence = integer("frame.sequence", frame.sequence, 0, _UINT64_MAX - 1)
            if sequence < self._next_sequence:
                raise bad_argument(
                    "frame.sequence",
                    f"{sequence} is below {self._next_sequence}, the next that may "
                    "be sent",
                )
        capture = frame.capture_time_ns
        if capture is None:
            capture = time.monotonic_ns()
        integer("frame.capture_time_ns", capture, 0, (1 << 63) - 1)
        return sequence, _convert.frame_to(frame, sequence, capture)

    def push(self, sequence: int, message: Any) -> None:
        self._next_sequence = sequence + 1
        self._unanswered.append((sequence, message))

    # --- the connection's side

    def attach_request(self) -> Any:
        """The first message of a connection."""
        request = tracking_pb2.TrackRequest()
        request.attach.session_id = self.session_id
        if self._unanswered:
            request.attach.resume_from = self._unanswered[0][0]
        elif self.attached_once:
            request.attach.resume_from = self._next_sequence
        else:
            # Answers to an earlier client's frames are not ours to deliver.
            request.attach.resume_from = _UINT64_MAX
        return request

    def attached(self, response: Any) -> None:
        """Takes the first response of a connection."""
        if not response.HasField("attached"):
            raise InternalError("the server did not say that it is attached")
        expected = response.attached.next_sequence
        if self.attached_once:
            self.num_reconnects += 1
        else:
            self.attached_once = True
            self.first_sequence = self._next_sequence = expected
        # Frames that have arrived before are not sent again.
        self._num_written = sum(1 for s, _ in self._unanswered if s < expected)
        self._connected = True

    @property
    def can_write(self) -> bool:
        return self._num_written < len(self._unanswered)

    def next_to_write(self) -> Any:
        """Counted before it is written: its answer may be there sooner."""
        message = self._unanswered[self._num_written][1]
        self._num_written += 1
        return message

    def take(self, response: Any) -> None:
        """Takes an answer off the connection, for the caller."""
        answer = _convert.answer_from(response)
        while (
            self._unanswered
            and self._num_written > 0
            and self._unanswered[0][0] <= answer.sequence
        ):
            sequence, _ = self._unanswered.popleft()
            self._num_written -= 1
            if sequence == answer.sequence:
                self.answers.append(answer)
                return
            # Answers come in order, so this one will not come any more.
            self._lost(sequence)

    def end_of_connection(self, error: Optional[GroundlockError]) -> bool:
        """The connection is over, in good order or by an error: True if the
        stream is to be connected again."""
        if self._connected:
            # The time without a connection begins now, however long it held.
            self._connected = False
            self._attempt = 0
            self._give_up_at = time.monotonic() + self.options.give_up_after_s
        if self.over:
            return False
        if error is None:
            if self.closed and not self.can_write:
                # It ended too early: answers that were not sent are lost.
                for sequence, _ in self._unanswered:
                    self._lost(sequence)
                self._unanswered.clear()
                self._num_written = 0
                self.end(None)
                return False
            error = UnavailableError("the server ended the stream")
        # The first connection is the caller's to repeat.
        if not self.attached_once or not is_transient(error):
            self.end(error)
            return False
        self._last_error = error
        return True

    def backoff_s(self) -> Optional[float]:
        """How long to wait before the next attempt; None: it is given up."""
        wait = min(
            self.options.first_backoff_s * 2.0 ** min(self._attempt, 16),
            self.options.last_backoff_s,
        )
        self._attempt += 1
        if time.monotonic() + wait > self._give_up_at:
            self.end(
                UnavailableError(
                    "the connection was lost and could not be restored: "
                    f"{self._last_error.message}"
                )
            )
            return None
        return wait

    def end(self, error: Optional[GroundlockError]) -> None:
        if not self.over:
            self.over = True
            self.error = error

    def _lost(self, sequence: int) -> None:
        lost = DataLossError("the server no longer has the answer")
        self.answers.append(FrameFailed(sequence, lost))
