# SPDX-License-Identifier: Apache-2.0
"""Recordings that the real dashboard has made; and damaged ones."""
from __future__ import annotations

import random
import struct
import zlib

import numpy as np
import pytest

import groundlock as gl
from conftest import RECORDED
from dashboard import available
from groundlock import recording as module

def test_what_was_recorded_is_what_was_answered(recorded, camera, frames):
    path, answers = recorded
    with gl.Recording(path) as recording:
        assert recording.complete
        assert recording.session.session_id == "rec"
        assert recording.session.camera == camera
        assert recording.map.name == "yard"
        results = list(recording.results())
        assert [r.sequence for r in results] == [a.sequence for a in answers]
        for result, answer in zip(results, answers):
            assert result.camera == answer.camera and result.targets == answer.targets
        images = list(recording.images())
        assert {i.capture_time_ns for i in images} <= {f.capture_time_ns for f in frames}
        shape = images[0].image.to_array().shape
        assert shape == frames[0].image.shape
        cloud = recording.point_cloud()
        assert len(cloud.xyz_world) > 100
        assert recording.start_time() is not None
        table = gl.to_frame(recording.results())
        assert len(table) == RECORDED and np.isfinite(table.box_x).all()


def test_an_interrupted_recording_is_read_up_to_its_last_chunk(recorded, tmp_path):
    path, answers = recorded
    data = path.read_bytes()
    cut = tmp_path / "cut.mcap"
    counts = []
    for part in (0.4, 0.7, 0.95):
        cut.write_bytes(data[: int(part * len(data))])
        try:
            with gl.Recording(cut) as recording:
                assert not recording.complete
                results = list(recording.results())
        except gl.DataLossError as error:
            assert "holds no session" in str(error)
            continue
        counts.append(len(results))
        assert [r.sequence for r in results] == [a.sequence for a in answers[: len(results)]]
    assert counts == sorted(counts) and counts[-1] > 0


def _small(messages):
    """An uncompressed file of one chunk without an index."""

    def record(opcode, content):
        return struct.pack("<BQ", opcode, len(content)) + content

    def text(value):
        return struct.pack("<I", len(value)) + value.encode()

    channels = {"/session/info": 1, "/session/result": 2}
    inner = b"".join(
        record(0x04, struct.pack("<HH", n, 0) + text(t) + text("protobuf") + struct.pack("<I", 0))
        for t, n in channels.items()
    )
    for topic, message in messages:
        head = struct.pack("<HIQQ", channels[topic], 0, 1, 2)
        inner += record(0x05, head + message.SerializeToString())
    chunk = struct.pack("<QQQI", 0, 0, len(inner), zlib.crc32(inner)) + text("")
    chunk += struct.pack("<Q", len(inner)) + inner
    return b"\x89MCAP0\r\n" + record(0x01, text("") + text("x")) + record(0x06, chunk)


@pytest.fixture(scope="module")
def small(camera):
    from groundlock import _convert
    from groundlock.v1 import tracking_pb2

    session = tracking_pb2.Session(session_id="s", camera=_convert.camera_to(camera))
    result = tracking_pb2.FrameResult(sequence=3)
    result.camera.state = tracking_pb2.CAMERA_STATE_LOST
    return _small([("/session/info", session), ("/session/result", result)])


def read_all(path):
    with gl.Recording(path) as recording:
        list(recording.results())
        list(recording.images())
        recording.point_cloud()
        list(recording.messages())


def test_damage_is_named(small, tmp_path):
    path = tmp_path / "small.mcap"
    path.write_bytes(small)
    with gl.Recording(path) as recording:
        assert [r.sequence for r in recording.results()] == [3] and recording.map is None
    with pytest.raises(gl.NotFoundError, match="no such|No such"):
        gl.Recording(tmp_path / "none.mcap")
    path.write_bytes(b"GIF89a" + small)
    with pytest.raises(gl.DataLossError, match="is no MCAP file"):
        gl.Recording(path)
    path.write_bytes(small[:-1] + bytes([small[-1] ^ 1]))
    with pytest.raises(gl.DataLossError, match="small.mcap: at byte .*checksum"):
        gl.Recording(path)


def test_strangers_bytes_do_no_harm(small, request, tmp_path):
    """Mutated files are read, or refused in words; nothing else happens."""
    seeds = [small]
    if available():
        seeds.append(request.getfixturevalue("recorded")[0].read_bytes())
    rng = random.Random(11)
    path = tmp_path / "mutant.mcap"
    outcomes = {"read": 0, "refused": 0}
    for i in range(400):
        data = bytearray(seeds[i % len(seeds)] if i % 8 == 0 else seeds[0])
        for _ in range(rng.choice((1, 1, 2, 8))):
            at = rng.randrange(8, len(data))
            kind = rng.random()
            if kind < 0.5:
                data[at] = rng.randrange(256)
            elif kind < 0.7:
                data[at : at + 8] = rng.choice((b"\xff" * 8, b"\x00" * 8, struct.pack("<Q", 1 << 40)))
            elif kind < 0.85:
                del data[at : at + rng.randrange(1, 64)]
            else:
                data[at:at] = rng.randbytes(rng.randrange(1, 64))
            if len(data) < 16:
                break
        path.write_bytes(data)
        try:
            read_all(path)
            outcomes["read"] += 1
        except gl.GroundlockError:
            outcomes["refused"] += 1
    assert outcomes["read"] > 0 and outcomes["refused"] > 100


def test_a_chunk_that_expands_is_bounded():
    zstandard = pytest.importorskip("zstandard")
    bomb = zstandard.ZstdCompressor().compress(b"\0" * (1 << 24))
    assert len(bomb) < 5000
    # It promised 100 bytes; no more than that is taken out of it.
    assert len(module._decompress(bomb, 100)) == 101
    with pytest.raises(ValueError, match="decompressed"):
        module._decompress(b"no zstd", 100)
