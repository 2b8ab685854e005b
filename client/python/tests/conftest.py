# SPDX-License-Identifier: Apache-2.0
"""A scene with its map and its truth, and a server that has it."""
from __future__ import annotations

import csv
import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

import groundlock
from dashboard import Dashboard, available
from support import BIN, HERE, Network, Server, until

FRAMES = 18
RECORDED = 8


@dataclass(frozen=True)
class Scene:
    folder: Path
    video: Path
    camera: Path
    map: Path
    align: Path
    truth: list
    box: tuple


def pytest_configure(config):
    missing = [p for p in ("groundlock-server", "groundlock") if not (BIN / p).is_file()]
    if missing:
        pytest.exit(f"{BIN}: {missing[0]} is not built", returncode=77)


@pytest.fixture(scope="session")
def scene():
    """sim/lot of the data folder; without one, a rendered yard."""
    data = os.environ.get("GROUNDLOCK_DATA", HERE.parents[3] / "shared" / "data")
    folder = Path(data) / "sim" / "lot"
    if not (folder / "occlusion.mp4").is_file():
        folder = Path(os.environ.get("GROUNDLOCK_SCRATCH", "/tmp")) / "groundlock-yard"
        if not (folder / "done").is_file():
            for sequence in ("mapping", "occlusion"):
                subprocess.run(
                    [
                        *(BIN / "groundlock", "simulate", "yard", sequence),
                        *("--size", "640x360", "--samples", "2", "--out", folder),
                    ],
                    check=True,
                    stdout=subprocess.DEVNULL,
                )
            (folder / "done").touch()
    with open(folder / "occlusion_truth.csv", newline="") as stream:
        truth = list(csv.DictReader(stream))
    box = tuple(float(truth[0][f"vis_{n}"]) for n in ("x", "y", "w", "h"))
    return Scene(
        folder,
        folder / "occlusion.mp4",
        folder / "camera.json",
        folder / "map",
        folder / "align.json",
        truth,
        box,
    )


@pytest.fixture(scope="session")
def frames(scene):
    """The first frames of the video."""
    with groundlock.Video(scene.video, last=FRAMES) as video:
        return list(video)


@pytest.fixture(scope="session")
def stored(scene, tmp_path_factory):
    """A store with the map `yard` in it."""
    folder = tmp_path_factory.mktemp("stored")
    server = Server(folder)
    try:
        with groundlock.Client(server.address) as client:
            client.import_map("yard", scene.map, align=scene.align)
    finally:
        server.stop()
    return folder / "store"


@pytest.fixture(scope="session")
def shared_server(stored, tmp_path_factory):
    """One that all tests may use which do not kill it."""
    folder = tmp_path_factory.mktemp("server")
    shutil.copytree(stored, folder / "store")
    server = Server(folder)
    yield server
    server.stop()


@pytest.fixture
def own_server(stored, tmp_path):
    """Makes servers that the test may do anything to."""
    servers = []

    def make(*arguments):
        folder = tmp_path / f"server-{len(servers)}"
        shutil.copytree(stored, folder / "store")
        servers.append(Server(folder, *arguments))
        return servers[-1]

    yield make
    for server in servers:
        server.stop()


@pytest.fixture
def client(shared_server):
    with groundlock.Client(shared_server.address) as client:
        yield client


@pytest.fixture
def network(shared_server):
    network = Network(shared_server.port)
    yield network
    network.close()


@pytest.fixture(scope="session")
def camera(scene):
    return groundlock.CameraModel.read(scene.camera)


@pytest.fixture(scope="session")
def recorded(shared_server, camera, frames, scene, tmp_path_factory):
    """(path, the answers that its session gave)."""
    if not available():
        pytest.skip("groundlock-dashboard is not built")
    dashboard = Dashboard(tmp_path_factory.mktemp("dashboard") / "d", shared_server.address)
    try:
        with groundlock.Client(shared_server.address) as client:
            with client.create_session(map="yard", camera=camera, session_id="rec") as session:
                session.set_target("car", scene.box, sequence=0)

                def seen():
                    try:
                        return dashboard.request(start_recording={"session_id": "rec", "name": "rec"})
                    except AssertionError:
                        return None  # it has not heard of the session yet

                until("the recording", seen)
                answers = []
                # One at a time: a watcher that lags behind misses some.
                with session.stream() as stream:
                    for f in frames[:RECORDED]:
                        stream.send(groundlock.Frame(f.image, f.number, f.capture_time_ns))
                        answers.append(stream.receive(timeout_s=120))
                        until("the watcher", lambda n=len(answers): _recorded(dashboard, n))
                dashboard.request(stop_recording={"session_id": "rec"})
    finally:
        dashboard.close()
    scratch = os.environ.get("GROUNDLOCK_SCRATCH")
    if scratch:  # for the TypeScript client's tests
        shutil.copyfile(dashboard.recording("rec"), Path(scratch) / "recording.mcap")
    return dashboard.recording("rec"), answers


def _recorded(dashboard, count):
    """Whether the file holds so many results."""
    try:
        with groundlock.Recording(dashboard.recording("rec")) as recording:
            return sum(1 for _ in recording.results()) >= count
    except groundlock.GroundlockError:
        return False
