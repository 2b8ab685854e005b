# SPDX-License-Identifier: Apache-2.0
"""Tokens, TLS, and servers of a program's own."""
from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from importlib import metadata

import pytest

import groundlock as gl
from support import BIN, HERE, until

TOKEN = "a-token-of-the-python-test"


def test_which_build():
    told = subprocess.run(
        [sys.executable, "-m", "groundlock", "--version"], check=True, capture_output=True, text=True
    ).stdout.strip()
    assert told == gl.BUILD
    assert gl.__version__ == metadata.version("groundlock")
    commit = os.environ["GROUNDLOCK_COMMIT"]
    assert gl.BUILD == (f"{gl.__version__} ({commit})" if commit else gl.__version__)


def test_nobody_answers():
    with pytest.raises(gl.UnavailableError, match="127.0.0.1:1: .*groundlock-server"):
        gl.connect("127.0.0.1:1", connect_timeout_s=0.3)


def test_tokens(own_server, tmp_path, monkeypatch):
    tokens = tmp_path / "tokens"
    tokens.write_text(f"{TOKEN}\n")
    tokens.chmod(0o600)
    server = own_server("--token-file", tokens)
    monkeypatch.delenv("GROUNDLOCK_TOKEN", raising=False)
    with gl.connect(server.address) as client:
        with pytest.raises(gl.UnauthenticatedError):
            client.list_maps()
    for arguments in ({"token": TOKEN}, {"token_file": tokens}):
        with gl.connect(server.address, **arguments) as client:
            assert [m.name for m in client.list_maps()] == ["yard"]
    monkeypatch.setenv("GROUNDLOCK_TOKEN", TOKEN)
    with gl.connect(server.address) as client:
        assert [m.name for m in client.list_maps()] == ["yard"]
        with client.create_session(map=None, camera=gl.CameraModel("PINHOLE", 64, 48, (60, 60, 32, 24))) as session:
            with session.stream() as stream:
                assert stream.next_sequence == 0
    with gl.connect(server.address, token="another-token-0000") as client:
        with pytest.raises(gl.UnauthenticatedError):
            client.create_session(map=None, camera=gl.CameraModel("PINHOLE", 64, 48, (60, 60, 32, 24)))
    with gl.connect(server.address, token=TOKEN) as client:
        caller = client.caller()
        assert not caller.open_to_all and "sessions:own" in caller.scopes
        with client.create_session(map=None) as session:
            assert session.info().owner == caller.name
    empty = tmp_path / "empty"
    empty.write_text("\n")
    with pytest.raises(gl.InvalidArgumentError, match="holds no token"):
        gl.connect(server.address, token_file=empty)


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    folder = tmp_path_factory.mktemp("certificates")
    folder.chmod(0o700)

    def openssl(*arguments):
        subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True)

    new = ("req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2")
    openssl(*new, "-keyout", "ca.key", "-out", "ca.pem", "-subj", "/CN=Test CA")
    for name in ("localhost", "client"):
        openssl("req", "-newkey", "rsa:2048", "-nodes", "-keyout", f"{name}.key", "-out", f"{name}.csr", "-subj", f"/CN={name}")
        (folder / "ext").write_text(f"subjectAltName=DNS:{name}\n")
        openssl("x509", "-req", "-in", f"{name}.csr", "-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial", "-days", "2", "-out", f"{name}.pem", "-extfile", "ext")
    for key in folder.glob("*.key"):
        key.chmod(0o600)
    return folder


def test_tls(own_server, certificates, camera, frames):
    server = own_server(
        *("--tls-cert", certificates / "localhost.pem"),
        *("--tls-key", certificates / "localhost.key"),
    )
    address = f"localhost:{server.port}"
    with gl.connect(address, tls=gl.TLS(ca=certificates / "ca.pem")) as client:
        with client.create_session(map=None, camera=camera) as session:
            answers = list(session.track([frames[0].image, frames[1].image]))
            assert [a.sequence for a in answers] == [0, 1]
    # Another name than the certificate's, unless it is told.
    tls = gl.TLS(ca=certificates / "ca.pem", server_name="localhost")
    with gl.connect(f"grpcs://127.0.0.1:{server.port}", tls=tls) as client:
        client.list_maps()
    wrong = [(address, None), (address, gl.TLS(ca=certificates / "client.pem")), (f"grpcs://{address}", None)]
    for target, tls in wrong:
        with pytest.raises(gl.UnavailableError):
            gl.connect(target, tls=tls, connect_timeout_s=1)


def test_the_example_of_a_server_elsewhere(own_server, certificates, tmp_path, monkeypatch):
    """docs/python.md's, with a server that there is."""
    page = (HERE.parents[2] / "docs" / "python.md").read_text()
    (code,) = re.findall(r"^```python no-run\n(.*?)^```", page, re.M | re.S)
    (tmp_path / "token").write_text(f"{TOKEN}\n")
    (tmp_path / "token").chmod(0o600)
    (tmp_path / "ca.pem").symlink_to(certificates / "ca.pem")
    server = own_server(
        *("--tls-cert", certificates / "localhost.pem"),
        *("--tls-key", certificates / "localhost.key"),
        *("--token-file", tmp_path / "token"),
    )
    monkeypatch.chdir(tmp_path)
    assert "tracker.example.org:443" in code
    names = {"groundlock": gl}
    exec(code.replace("tracker.example.org:443", f"localhost:{server.port}"), names)
    with names["client"] as client:
        assert [m.name for m in client.list_maps()] == ["yard"]


def test_tls_with_a_certificate_of_the_client(own_server, certificates):
    server = own_server(
        *("--tls-cert", certificates / "localhost.pem"),
        *("--tls-key", certificates / "localhost.key"),
        *("--tls-client-ca", certificates / "ca.pem", "--tls-require-client-cert"),
    )
    address = f"localhost:{server.port}"
    with pytest.raises(gl.UnavailableError):
        gl.connect(address, tls=gl.TLS(ca=certificates / "ca.pem"), connect_timeout_s=1)
    tls = gl.TLS(certificates / "ca.pem", certificates / "client.pem", certificates / "client.key")
    with gl.connect(address, tls=tls) as client:
        assert "yard" in [m.name for m in client.list_maps()]


def alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as stream:
            return stream.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_server_of_its_own(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    monkeypatch.setenv("GROUNDLOCK_BIN", str(BIN))
    with gl.connect(local=True) as client:
        assert client.list_maps() == []
        assert (tmp_path / "groundlock" / "maps").is_dir()
        pid = int(subprocess.run(
            ["pgrep", "-f", "-P", str(os.getpid()), str(tmp_path / "groundlock")],
            capture_output=True, text=True, check=True).stdout.split()[0])
        assert alive(pid)
    assert not alive(pid)


def test_it_ends_with_the_program(tmp_path):
    """Also where that is killed, and also if the thread that asked for the
    server has ended before."""
    script = (
        "import threading, time, groundlock\n"
        "def start():\n"
        "    global server\n"
        "    server = groundlock.LocalServer()\n"
        "t = threading.Thread(target=start); t.start(); t.join()\n"
        "time.sleep(0.3)\n"
        "print(server.pid, flush=True)\n"
        "time.sleep(60)\n"
    )
    environment = {**os.environ, "XDG_DATA_HOME": str(tmp_path), "GROUNDLOCK_BIN": str(BIN)}
    program = subprocess.Popen([sys.executable, "-c", script], env=environment, stdout=subprocess.PIPE, text=True)
    pid = int(program.stdout.readline())
    assert alive(pid)
    program.send_signal(signal.SIGKILL)
    program.wait()
    until("the end of the server", lambda: not alive(pid))


def test_no_server_program(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    monkeypatch.delenv("GROUNDLOCK_BIN", raising=False)
    monkeypatch.setenv("PATH", "/usr/bin:/bin")
    with pytest.raises(gl.NotFoundError, match="PATH"):
        gl.connect(local=True)
    with pytest.raises(gl.NotFoundError) as caught:
        gl.LocalServer(program="/no/such")
    assert caught.value.field == "program"
    with pytest.raises(gl.UnavailableError, match="server.log"):
        gl.LocalServer(program="/bin/false")
