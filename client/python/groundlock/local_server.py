# SPDX-License-Identifier: Apache-2.0
"""A server of the program's own, for a person who has started none; and
connect(), which chooses one."""
from __future__ import annotations

import os
import shutil
import socket
import subprocess
import tempfile
import threading
import time
import weakref
from pathlib import Path
from types import TracebackType
from typing import Any, List, Optional, Tuple, Type

from ._channel import DEFAULT_PORT, ClientOptions, PathLike, TLS, find_token
from .client import Client
from .errors import (
    FailedPreconditionError,
    NotFoundError,
    UnavailableError,
    bad_argument,
)

# A store of thousands of maps opens in well under a second.
_START_LIMIT_S = 30.0
_STOP_LIMIT_S = 10.0
_POLL_S = 0.02


def user_data_folder() -> Path:
    """Where a person's own maps are: groundlock/ in $XDG_DATA_HOME, or in
    ~/.local/share; the same as of `groundlock --local`."""
    data = os.environ.get("XDG_DATA_HOME", "")
    if os.path.isabs(data):
        return Path(data) / "groundlock"
    home = os.environ.get("HOME", "")
    if home:
        return Path(home) / ".local" / "share" / "groundlock"
    raise FailedPreconditionError(
        "neither XDG_DATA_HOME nor HOME says where maps may be kept"
    )


def loopback_answers(port: int = DEFAULT_PORT) -> bool:
    """Whether anything accepts connections on that port of this machine. A
    refusal is known at once, without gRPC's attempts to try again."""
    with socket.socket() as probe:
        probe.settimeout(1.0)
        return probe.connect_ex(("127.0.0.1", port)) == 0


class _Child:
    """The process, started and waited for by a thread that lives as long as it:
    the kernel's signal at the parent's death comes at the end of the thread
    that started it."""

    def __init__(self, command: List[str], log: Any, environment: Any) -> None:
        self._started = threading.Event()
        self._failure: Optional[OSError] = None
        self.process: Optional["subprocess.Popen[bytes]"] = None
        self._thread = threading.Thread(
            target=self._run,
            args=(command, log, environment),
            name="groundlock-server",
            daemon=True,
        )
        self._thread.start()
        self._started.wait()
        if self._failure is not None:
            raise self._failure

    def _run(self, command: List[str], log: Any, environment: Any) -> None:
        try:
            self.process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env=environment,
                # Ctrl-C in the terminal is for the client, which then ends its
                # session.
                start_new_session=True,
            )
        except OSError as error:
            self._failure = error
            return
        finally:
            self._started.set()
        self.process.wait()

    def stop(self) -> None:
        process = self.process
        if process is None or process.poll() is not None:
            return
        process.terminate()
        self._thread.join(_STOP_LIMIT_S)
        if self._thread.is_alive():
            process.kill()
            self._thread.join()


class LocalServer:
    """groundlock-server as a child process on a free port of the loopback
    address, with its maps in the user's data folder, for as long as this object
    is open; it also ends with this process. Programs that run at the same time
    may each have one: they share the store.

    program: its path; None = $GROUNDLOCK_BIN/groundlock-server where that is
    set, else the one in $PATH. store: the folder of the maps; None = the user's.
    arguments: further ones of the server.

    NotFoundError: there is no such program. UnavailableError: it ended at once
    or takes too long; names its log.
    """

    def __init__(
        self,
        *,
        program: Optional[PathLike] = None,
        store: Optional[PathLike] = None,
        arguments: Optional[List[str]] = None,
    ) -> None:
        executable = self._find(program)
        if store is None:
            folder = user_data_folder()
            self.store = folder / "maps"
        else:
            self.store = Path(store).absolute()
            folder = self.store.parent
        self.log = folder / "server.log"
        try:
            self.store.mkdir(parents=True, exist_ok=True)
            log = open(self.log, "ab")
        except OSError as error:
            raise FailedPreconditionError(
                f"{error.filename}: cannot be written: {error.strerror}"
            ) from None
        with log, tempfile.TemporaryDirectory(prefix="groundlock-") as scratch:
            port_file = Path(scratch) / "port"
            command = [
                *self._ends_with_parent(),
                executable,
                "--listen",
                "127.0.0.1:0",
                "--metrics",
                "",
                "--store",
                str(self.store),
                "--port-file",
                str(port_file),
                "--grace",
                "2",
                *(arguments or []),
            ]
            self._child = _Child(command, log, None)
            self._finalizer = weakref.finalize(self, self._child.stop)
            try:
                self.address = f"127.0.0.1:{self._wait(port_file)}"
            except BaseException:
                self.close()
                raise

    @staticmethod
    def _find(program: Optional[PathLike]) -> str:
        if program is not None:
            if not os.access(program, os.X_OK):
                raise NotFoundError(
                    f"program: {program}: is no program", field="program"
                )
            return str(program)
        folder = os.environ.get("GROUNDLOCK_BIN")
        if folder and os.access(Path(folder) / "groundlock-server", os.X_OK):
            return str(Path(folder).absolute() / "groundlock-server")
        found = shutil.which("groundlock-server")
        if found is None:
            raise NotFoundError(
                "groundlock-server is not in PATH: install it, or name the "
                "HOST:PORT of a running one as `server`"
            )
        return found

    @staticmethod
    def _ends_with_parent() -> List[str]:
        """util-linux' way to ask the kernel to end a child with its parent,
        without code of ours between fork and exec."""
        setpriv = shutil.which("setpriv")
        return [setpriv, "--pdeathsig", "TERM", "--"] if setpriv else []

    def _wait(self, port_file: Path) -> int:
        end = time.monotonic() + _START_LIMIT_S
        process = self._child.process
        assert process is not None
        while True:
            # The server writes the file whole, and only once it serves.
            if port_file.is_file():
                text = port_file.read_text().strip()
                if text:
                    return int(text)
            if process.poll() is not None:
                raise UnavailableError(
                    f"the program's own server ended at once; its log: {self.log}"
                )
            if time.monotonic() > end:
                raise UnavailableError(
                    "the program's own server does not serve after "
                    f"{_START_LIMIT_S:.0f} s; its log: {self.log}"
                )
            time.sleep(_POLL_S)

    @property
    def pid(self) -> int:
        assert self._child.process is not None
        return self._child.process.pid

    def close(self) -> None:
        """Asks it to end, and waits."""
        self._finalizer()

    def __enter__(self) -> LocalServer:
        return self

    def __exit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        self.close()


def choose_server(
    server: Optional[str], local: bool, tls: Optional[TLS]
) -> Tuple[str, Optional[LocalServer]]:
    """The server that was named, or the one that is there, or one of our own,
    which speaks no TLS."""
    if local and (server is not None or tls is not None):
        field = "server" if server is not None else "tls"
        raise bad_argument(field, "goes not together with local=True")
    if server is not None:
        return server, None
    if not local and (tls is not None or loopback_answers()):
        return f"127.0.0.1:{DEFAULT_PORT}", None
    own = LocalServer()
    return own.address, own


def connect(
    server: Optional[str] = None,
    *,
    local: bool = False,
    token: Optional[str] = None,
    token_file: Optional[PathLike] = None,
    tls: Optional[TLS] = None,
    connect_timeout_s: float = 5.0,
    call_timeout_s: float = 30.0,
) -> Client:
    """Connects to `server`: HOST:PORT, or grpcs://HOST:PORT for TLS. Where none is named, to the one on this
    machine's port 50551; where none answers there, or with local=True, to a
    LocalServer that lives as long as the client.

    token: None = the first line of token_file, or the environment's
    GROUNDLOCK_TOKEN, if there is one.
    """
    if token is None:
        token = find_token(token_file)
    options = ClientOptions(token, tls, connect_timeout_s, call_timeout_s)
    address, own = choose_server(server, local, tls)
    if own is None:
        return Client(address, options)
    try:
        return Client(address, options, on_close=own.close)
    except BaseException:
        own.close()
        raise
