# SPDX-License-Identifier: Apache-2.0
"""What an inertial measurement unit recorded, beside a video."""
from __future__ import annotations

import subprocess

import numpy as np
import pytest

import groundlock as gl
from support import BIN

FRAMES = 8


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A small drive with its unit, as the simulator writes them."""
    folder = tmp_path_factory.mktemp("drive")
    subprocess.run(
        [
            *(BIN / "groundlock", "simulate", "yard", "pan", "--size", "320x180"),
            *("--samples", "1", "--frames", str(FRAMES), "--out", folder),
        ],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    return folder


def test_recordings_are_read(drive, tmp_path):
    imu = gl.ImuModel.read(drive / "imu.json")
    assert imu.gyroscope_noise_rad_s_sqrt_hz is None or imu.gyroscope_noise_rad_s_sqrt_hz > 0
    samples = gl.InertialSamples.read(drive / "pan_imu.csv")
    table = np.loadtxt(drive / "pan_imu.csv", delimiter=",", comments="#")
    assert len(samples) == len(table) > FRAMES
    np.testing.assert_array_equal(samples.angular_rate_rad_s, table[:, 1:4])
    np.testing.assert_array_equal(samples.acceleration_m_s2, table[:, 4:7])
    # A clock's nanoseconds have more digits than a float.
    big = tmp_path / "data.csv"
    big.write_text("#timestamp [ns],w,w,w,a,a,a\n1403636579763555584,1,2,3,4,5,6,7\n\n")
    assert gl.InertialSamples.read(big).time_ns.tolist() == [1403636579763555584]
    for line, words in (
        ("1,2,3", r"line 2, column 4 \(w_z\): is missing"),
        ("1,2,x,4,5,6,7", r"line 2, column 3 \(w_y\): 'x' is not a number"),
        ("1,2,3,4,nan,6,7", r"line 2, column 5 \(a_x\): 'nan'"),
        ("1.5,2,3,4,5,6,7", r"line 2, column 1 \(timestamp \[ns\]\): '1.5' is not a whole number"),
        ("-1,2,3,4,5,6,7", "column 1"),
    ):
        big.write_text(f"# head\n{line}\n")
        with pytest.raises(gl.InvalidArgumentError, match=words) as caught:
            gl.InertialSamples.read(big)
        assert caught.value.field == str(big)


def test_each_sample_goes_with_one_frame():
    rows = np.zeros((100, 3))
    samples = gl.InertialSamples(np.arange(0, 1000, 10), rows, rows)
    dealt, previous = [], None
    for capture in (0, 40, 45, 300, 5000, 6000):
        dealt += samples.between(previous, capture).time_ns.tolist()
        previous = capture
        # Up to the first that is not before the frame.
        assert dealt[-1] == min(990, -(-capture // 10) * 10)
    assert dealt == samples.time_ns.tolist()
    late = samples.since(500)
    assert late.time_ns.tolist() == list(range(0, 500, 10))
    many = np.zeros((9000, 3))
    assert len(gl.InertialSamples(np.arange(9000), many, many).between(None, 8000)) == 4096
    assert gl.InertialSamples(np.arange(9000), many, many).between(None, 8000).time_ns[-1] == 8000


def test_they_reach_the_session(client, drive):
    """The server refuses what is not in order, so it has looked at what came."""
    imu = gl.ImuModel.read(drive / "imu.json")
    run = gl.track(
        drive / "pan.mp4",
        map=None,
        camera=drive / "camera.json",
        imu=drive / "imu.json",
        inertial=drive / "pan_imu.csv",
        client=client,
    )
    assert len(run.results) == FRAMES
    assert run.session.options.imu.imu_from_camera.angle_to(imu.imu_from_camera) < 1e-6
    assert not any(r.camera.ignores_gyroscope for r in run.results)
    options = gl.SessionOptions(imu=imu)
    with client.create_session(map=None, camera=drive / "camera.json", options=options) as session:
        picture = np.zeros((180, 320), np.uint8)
        samples = gl.InertialSamples([5, 6], np.zeros((2, 3)), np.zeros((2, 3)))
        far = gl.InertialSamples([5], np.full((1, 3), 1e300), np.zeros((1, 3)))
        answers = list(session.track([gl.Frame(picture, inertial=samples), gl.Frame(picture, inertial=far)]))
    assert [type(a) for a in answers] == [gl.FrameResult, gl.FrameFailed], answers
    assert "inertial" in str(answers[1].error)
