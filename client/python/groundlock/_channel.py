# SPDX-License-Identifier: Apache-2.0
"""How the plain and the asyncio client connect."""
from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Tuple, Union

import grpc
from google.protobuf import descriptor_pb2

from ._values import above_zero, integer
from .errors import InvalidArgumentError, NotFoundError, bad_argument
from .v1 import maps_pb2, tracking_pb2

DEFAULT_PORT = 50551

PathLike = Union[str, "os.PathLike[str]"]

# Any answer tells that the server is there; this needs no rights.
HEALTH_CHECK = "/grpc.health.v1.Health/Check"


@dataclass(frozen=True)
class TLS:
    """Encryption. Files are PEM.

    ca: what the server's certificate is checked against; None = the system's
    authorities. cert, key: this client's own, for servers that want one.
    server_name: the name in the server's certificate, where it is not the host
    that is connected to.
    """

    ca: Optional[PathLike] = None
    cert: Optional[PathLike] = None
    key: Optional[PathLike] = None
    server_name: Optional[str] = None

    def credentials(self) -> Any:
        if (self.cert is None) != (self.key is None):
            missing = "tls.key" if self.key is None else "tls.cert"
            raise bad_argument(missing, "is missing: tls.cert and tls.key go together")
        ca = self.ca
        if ca is None:
            # gRPC as Debian builds it brings no authorities of its own.
            system = Path("/etc/ssl/certs/ca-certificates.crt")
            ca = system if system.is_file() else None
        return grpc.ssl_channel_credentials(
            root_certificates=_read_pem("tls.ca", ca),
            private_key=_read_pem("tls.key", self.key),
            certificate_chain=_read_pem("tls.cert", self.cert),
        )


def _read_pem(field: str, path: Optional[PathLike]) -> Optional[bytes]:
    if path is None:
        return None
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise bad_argument(
            field, f"{path}: cannot be read: {error.strerror}"
        ) from None
    if b"-----BEGIN " not in content:
        raise bad_argument(field, f"{path}: is not a PEM file")
    return content


@dataclass(frozen=True)
class ClientOptions:
    """How a client connects; see Client."""

    token: Optional[str] = None
    tls: Optional[TLS] = None
    connect_timeout_s: float = 5.0
    call_timeout_s: float = 30.0
    max_message_bytes: int = 64 << 20

    def __post_init__(self) -> None:
        above_zero("connect_timeout_s", self.connect_timeout_s)
        above_zero("call_timeout_s", self.call_timeout_s)
        integer("max_message_bytes", self.max_message_bytes, 1, (1 << 31) - 1)
        if self.tls is not None and not isinstance(self.tls, TLS):
            raise bad_argument("tls", f"{self.tls!r} must be a TLS, or None")
        if self.token is not None and (
            not isinstance(self.token, str)
            or not self.token
            or not self.token.isascii()
            or not self.token.isprintable()
        ):
            raise bad_argument("token", "must be printable ASCII characters")


def find_token(file: Optional[PathLike] = None) -> Optional[str]:
    """The token to use: the first line of `file`; without one, the value of the
    environment's GROUNDLOCK_TOKEN; None if there is none."""
    if file is None:
        return os.environ.get("GROUNDLOCK_TOKEN") or None
    try:
        lines = Path(file).read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise NotFoundError(
            f"token_file: {file}: cannot be read: {error.strerror}", field="token_file"
        ) from None
    if not lines or not lines[0].strip():
        raise InvalidArgumentError(
            f"token_file: {file}: its first line holds no token", field="token_file"
        )
    return lines[0].strip()


def check_server(
    server: str, options: Optional[ClientOptions]
) -> Tuple[str, ClientOptions]:
    """HOST:PORT, as gRPC takes it; grpcs:// before it turns TLS on."""
    options = options or ClientOptions()
    target = str(server)
    if target.startswith("grpcs://"):
        target = target[len("grpcs://") :]
        if options.tls is None:
            options = dataclasses.replace(options, tls=TLS())
    elif target.startswith("grpc://"):
        target = target[len("grpc://") :]
    if target.startswith("unix:"):
        return target, options
    host, _, port = target.rpartition(":")
    if not host or "/" in host or not port.isdigit() or not 0 < int(port) < 65536:
        raise bad_argument(
            "server", f"{server!r} must be HOST:PORT, or grpcs://HOST:PORT for TLS"
        )
    return target, options


def channel_arguments(options: ClientOptions) -> List[Tuple[str, Any]]:
    """As those of the C++ client."""
    arguments: List[Tuple[str, Any]] = [
        ("grpc.max_receive_message_length", options.max_message_bytes),
        ("grpc.max_send_message_length", -1),  # the server knows its own limit
        ("grpc.keepalive_time_ms", 20_000),
        ("grpc.keepalive_timeout_ms", 10_000),
        # Streams reconnect by themselves and sooner than gRPC's default allows.
        ("grpc.initial_reconnect_backoff_ms", 100),
        ("grpc.min_reconnect_backoff_ms", 1_000),
        ("grpc.max_reconnect_backoff_ms", 5_000),
        # Clients in one process do not share a connection behind our back.
        ("grpc.use_local_subchannel_pool", 1),
    ]
    if options.tls is not None and options.tls.server_name:
        arguments.append(("grpc.ssl_target_name_override", options.tls.server_name))
    return arguments


def open_channel(module: Any, server: str, options: ClientOptions) -> Any:
    """module: grpc or grpc.aio. Does not wait for the server; connects, and
    connects again, when it is used."""
    arguments = channel_arguments(options)
    if options.tls is None:
        return module.insecure_channel(server, options=arguments)
    return module.secure_channel(server, options.tls.credentials(), options=arguments)


def metadata(options: ClientOptions) -> Tuple[Tuple[str, str], ...]:
    """What every call carries. gRPC's own call credentials would want TLS,
    which ends at a proxy where there is one."""
    if not options.token:
        return ()
    return (("authorization", f"Bearer {options.token}"),)


def make_calls(channel: Any) -> Dict[str, Callable[..., Any]]:
    """The methods of both services by name, as gRPC's callables."""
    calls: Dict[str, Callable[..., Any]] = {}
    for module in (maps_pb2, tracking_pb2):
        for service in module.DESCRIPTOR.services_by_name.values():
            for method in service.methods:
                calls[method.name] = _call(channel, service, method)
    return calls


def _call(channel: Any, service: Any, method: Any) -> Callable[..., Any]:
    described = descriptor_pb2.MethodDescriptorProto()
    method.CopyToProto(described)
    kind = "_".join(
        "stream" if streams else "unary"
        for streams in (described.client_streaming, described.server_streaming)
    )
    make = getattr(channel, kind)
    result: Callable[..., Any] = make(
        f"/{service.full_name}/{method.name}",
        request_serializer=method.input_type._concrete_class.SerializeToString,
        response_deserializer=method.output_type._concrete_class.FromString,
    )
    return result
