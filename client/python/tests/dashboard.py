# SPDX-License-Identifier: Apache-2.0
"""As much of a browser as it takes to have groundlock-dashboard record."""
from __future__ import annotations

import base64
import os
import shutil
import socket
import struct
import subprocess
import tempfile
from pathlib import Path

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from support import BIN, HERE, until


def _messages():
    """The dashboard's messages, in a pool of their own."""
    root = HERE.parents[2] / "proto"
    if not root.is_dir():
        root = Path(os.environ["GROUNDLOCK_PROTO"])
    with tempfile.NamedTemporaryFile() as out:
        subprocess.run(
            [
                *("protoc", f"-I{root}", "--include_imports", f"-o{out.name}"),
                "groundlock/dashboard/v1/dashboard.proto",
            ],
            check=True,
        )
        files = descriptor_pb2.FileDescriptorSet.FromString(Path(out.name).read_bytes())
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    factory = message_factory.MessageFactory(pool)
    name = "groundlock.dashboard.v1."
    return [
        factory.GetPrototype(pool.FindMessageTypeByName(name + kind))
        for kind in ("ClientMessage", "ServerMessage")
    ]


class Dashboard:
    """The program, and a WebSocket to it (RFC 6455, binary messages)."""

    def __init__(self, folder: Path, server: str) -> None:
        self.folder = folder
        folder.mkdir(parents=True)
        (folder / "web").mkdir()
        (folder / "web" / "index.html").write_text("<html></html>")
        port_file = folder / "port"
        self.process = subprocess.Popen(
            [
                *(BIN / "groundlock-dashboard", "--listen", "127.0.0.1:0"),
                *("--server", server, "--port-file", port_file),
                *("--data", folder / "data", "--web", folder / "web"),
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        until("the dashboard", lambda: port_file.is_file() and port_file.read_text().strip())
        port = int(port_file.read_text())
        self._client, self._server = _messages()
        # It answers 503 until it has found its server.
        until("its WebSocket", lambda: self._upgrade(port))
        while self._in.readline().strip():
            pass
        self._id = 0

    def _upgrade(self, port: int) -> bool:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=120)
        key = base64.b64encode(os.urandom(16)).decode()
        self._socket.sendall(
            f"GET /ws HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\n"
            f"Origin: http://127.0.0.1:{port}\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        self._in = self._socket.makefile("rb")
        status = self._in.readline()
        if b" 503 " in status:
            self._in.close()
            self._socket.close()
            return False
        assert b" 101 " in status, status
        return True

    def request(self, **fields):
        """Sends a request and returns its reply."""
        self._id += 1
        payload = self._client(request_id=self._id, **fields).SerializeToString()
        mask = os.urandom(4)
        assert len(payload) < 126
        masked = bytes(b ^ mask[i % 4] for i, b in enumerate(payload))
        self._socket.sendall(struct.pack("!BB", 0x82, 0x80 | len(payload)) + mask + masked)
        while True:
            first, second = self._in.read(2)
            size = second & 127
            if size == 126:
                size = struct.unpack("!H", self._in.read(2))[0]
            elif size == 127:
                size = struct.unpack("!Q", self._in.read(8))[0]
            data = self._in.read(size)
            if first & 15 != 2:
                continue
            reply = self._server.FromString(data)
            if reply.request_id == self._id:
                assert reply.WhichOneof("message") != "error", reply
                return reply

    def recording(self, name: str) -> Path:
        return self.folder / "data" / "recordings" / f"{name}.mcap"

    def close(self) -> None:
        self._socket.close()
        self.process.terminate()
        self.process.wait(120)


def available() -> bool:
    return (BIN / "groundlock-dashboard").is_file() and shutil.which("protoc") is not None
