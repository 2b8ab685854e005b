# SPDX-License-Identifier: Apache-2.0
"""What goes wrong, as exceptions: one class for each code of the protocol.

All are a GroundlockError with the code and a message that names the field,
file, line or frame at fault. Where an argument was refused before anything was
sent, `field` holds the argument's name.
"""
from __future__ import annotations

import difflib
import enum
from typing import Any, Dict, Iterable, Optional, Type

import grpc


class Code(enum.IntEnum):
    """The numbers of google.rpc.Code."""

    OK = 0
    CANCELLED = 1
    UNKNOWN = 2
    INVALID_ARGUMENT = 3
    DEADLINE_EXCEEDED = 4
    NOT_FOUND = 5
    ALREADY_EXISTS = 6
    PERMISSION_DENIED = 7
    RESOURCE_EXHAUSTED = 8
    FAILED_PRECONDITION = 9
    ABORTED = 10
    OUT_OF_RANGE = 11
    UNIMPLEMENTED = 12
    INTERNAL = 13
    UNAVAILABLE = 14
    DATA_LOSS = 15
    UNAUTHENTICATED = 16


class GroundlockError(Exception):
    """The base of all: `code`, `message`, and `field` or None."""

    code: Code = Code.UNKNOWN

    def __init__(
        self,
        message: str,
        *,
        code: Optional[Code] = None,
        field: Optional[str] = None,
    ) -> None:
        super().__init__(message)
        self.message = message
        self.field = field
        if code is not None:
            self.code = code


class InvalidArgumentError(GroundlockError, ValueError):
    """A field is unset, unknown or out of range, or bytes are damaged."""

    code = Code.INVALID_ARGUMENT


class NotFoundError(GroundlockError, LookupError):
    """No such map, version, session, target, file or program."""

    code = Code.NOT_FOUND


class AlreadyExistsError(GroundlockError):
    """The name is taken, or the file is there."""

    code = Code.ALREADY_EXISTS


class FailedPreconditionError(GroundlockError):
    """It cannot be done as things stand; the message says what to do."""

    code = Code.FAILED_PRECONDITION


class ResourceExhaustedError(GroundlockError):
    """A limit of the server: worth a retry later."""

    code = Code.RESOURCE_EXHAUSTED


class UnauthenticatedError(GroundlockError):
    """The server wants a token, or another one."""

    code = Code.UNAUTHENTICATED


class PermissionDeniedError(GroundlockError):
    """The token is not good for this."""

    code = Code.PERMISSION_DENIED


class UnavailableError(GroundlockError):
    """The server is stopping, or nobody answers."""

    code = Code.UNAVAILABLE


class DeadlineExceededError(GroundlockError):
    """It took too long."""

    code = Code.DEADLINE_EXCEEDED


class StreamCancelledError(GroundlockError):
    """This side ended the call."""

    code = Code.CANCELLED


class AbortedError(GroundlockError):
    """Another stream has taken over the session."""

    code = Code.ABORTED


class DataLossError(GroundlockError):
    """A stored map or a recording is damaged, or an answer was lost."""

    code = Code.DATA_LOSS


class UnimplementedError(GroundlockError):
    """This server cannot do that."""

    code = Code.UNIMPLEMENTED


class InternalError(GroundlockError):
    """A defect of ours or of a library."""

    code = Code.INTERNAL


_CLASSES: Dict[Code, Type[GroundlockError]] = {
    cls.code: cls
    for cls in (
        InvalidArgumentError,
        NotFoundError,
        AlreadyExistsError,
        FailedPreconditionError,
        ResourceExhaustedError,
        UnauthenticatedError,
        PermissionDeniedError,
        UnavailableError,
        DeadlineExceededError,
        StreamCancelledError,
        AbortedError,
        DataLossError,
        UnimplementedError,
        InternalError,
    )
}


def error_of(code: int, message: str) -> GroundlockError:
    """The exception for a code of the protocol; unknown codes are UNKNOWN."""
    try:
        known = Code(code)
    except ValueError:
        known = Code.UNKNOWN
    cls = _CLASSES.get(known)
    if cls is None:
        return GroundlockError(message, code=known)
    return cls(message)


def error_of_call(error: grpc.RpcError, server: str = "") -> GroundlockError:
    """The exception for what a call ended with."""
    call: Any = error
    code = call.code()
    number = int(code.value[0]) if code is not None else int(Code.UNKNOWN)
    message = call.details() or Code(number).name.lower().replace("_", " ")
    # gRPC's own words for a server that is not there do not name it.
    if number == Code.UNAVAILABLE and server:
        message = f"{server}: {message} (is groundlock-server running there?)"
    return error_of(number, message)


def bad_argument(field: str, problem: str) -> InvalidArgumentError:
    """`field: problem`, with the field to look at."""
    return InvalidArgumentError(f"{field}: {problem}", field=field)


def unknown_choice(
    field: str, value: object, choices: Iterable[str]
) -> InvalidArgumentError:
    """Names what would be right, and what was probably meant."""
    names = list(choices)
    lower = {name.lower(): name for name in names}
    close = difflib.get_close_matches(str(value).lower(), lower, n=1)
    hint = f" (did you mean {lower[close[0]]!r}?)" if close else ""
    return bad_argument(
        field, f"{value!r} is unknown; one of {', '.join(names)}{hint}"
    )
