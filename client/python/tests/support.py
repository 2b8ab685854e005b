# SPDX-License-Identifier: Apache-2.0
"""The real programs, started for a test and ended with it; and a network that
can be cut."""
from __future__ import annotations

import os
import socket
import subprocess
import threading
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
BIN = Path(os.environ.get("GROUNDLOCK_BIN", HERE.parents[2] / "build" / "bin")).absolute()


def until(what, probe, seconds=120.0):
    """Asks until there is an answer."""
    end = time.monotonic() + seconds
    while True:
        value = probe()
        if value:
            return value
        assert time.monotonic() < end, f"waited {seconds} s for {what}"
        time.sleep(0.02)


class Server:
    """groundlock-server on a store of its own; kill() and start() again keep
    the port."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self.arguments = arguments
        # Bound and not listening: the server may listen there, again and again,
        # and the system gives the port to nobody else in between.
        self._reserved = socket.socket()
        self._reserved.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._reserved.bind(("127.0.0.1", 0))
        self.port = self._reserved.getsockname()[1]
        self.process = None
        self.start()

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self.port}"

    def start(self) -> None:
        port_file = self.folder / "port"
        port_file.unlink(missing_ok=True)
        with open(self.folder / "server.log", "ab") as log:
            self.process = subprocess.Popen(
                [
                    BIN / "groundlock-server",
                    *("--listen", f"127.0.0.1:{self.port}", "--metrics", ""),
                    *("--store", self.folder / "store", "--port-file", port_file),
                    *self.arguments,
                ],
                stdout=log,
                stderr=log,
            )

        def serving():
            text = (self.folder / "server.log").read_text()
            assert self.process.poll() is None, text
            return port_file.is_file() and port_file.read_text().strip()

        assert int(until("the server", serving)) == self.port

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def stop(self) -> None:
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(120)
            except subprocess.TimeoutExpired:
                self.kill()
        self._reserved.close()


class Network:
    """A TCP proxy to a port whose connections can be cut."""

    def __init__(self, port: int) -> None:
        self._target = port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._lock = threading.Lock()
        self._open = []
        self.connections = 0
        self.bytes_up = 0
        self.cut_at = None  # bytes up at which all connections break, once
        self.up = True
        threading.Thread(target=self._accept, daemon=True).start()

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self.port}"

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            if not self.up:
                near.close()
                continue
            try:
                far = socket.create_connection(("127.0.0.1", self._target))
            except OSError:
                near.close()
                continue
            with self._lock:
                self.connections += 1
                self._open += [near, far]
            for source, sink, counted in ((near, far, True), (far, near, False)):
                threading.Thread(
                    target=self._pass, args=(source, sink, counted), daemon=True
                ).start()

    def _pass(self, source, sink, counted) -> None:
        try:
            while True:
                data = source.recv(1 << 16)
                if not data:
                    break
                sink.sendall(data)
                if counted:
                    self.bytes_up += len(data)
                    if self.cut_at is not None and self.bytes_up >= self.cut_at:
                        self.cut_at = None
                        self.cut()
        except OSError:
            pass
        for end in (source, sink):
            try:
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass

    def cut(self) -> None:
        """Breaks all connections there are."""
        with self._lock:
            ends, self._open = self._open, []
        for end in ends:
            try:
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass
            end.close()

    def close(self) -> None:
        self._listener.close()
        self.cut()
