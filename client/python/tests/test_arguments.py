# SPDX-License-Identifier: Apache-2.0
"""A wrong argument is named, and so is what would be right."""
from __future__ import annotations

import re

import numpy as np
import pytest

import groundlock as gl

Q = gl.Quaternion.identity()


def camera(**changes):
    values = {"model": "PINHOLE", "width_px": 640, "height_px": 480, "params": (500, 500, 320, 240)}
    return gl.CameraModel(**{**values, **changes})


# What is called; the field; what the message says besides.
LOCAL = [
    (lambda c: camera(model="PINHOL"), "camera.model", "one of SIMPLE_PINHOLE, PINHOLE.*did you mean 'PINHOLE'"),
    (lambda c: camera(params=(500, 320, 240)), "camera.params", "3 given, but PINHOLE has 4: fx, fy, cx, cy"),
    (lambda c: camera(params=(0, 500, 320, 240)), r"camera.params \(fx\)", "above 0"),
    (lambda c: camera(params=(500, 500, float("nan"), 240)), r"camera.params \(cx\)", "not finite"),
    (lambda c: camera(width_px=0), "camera.width_px", r"in \[1, 65535\]"),
    (lambda c: camera(height_px=480.5), "camera.height_px", "whole number"),
    (lambda c: gl.Quaternion(0, 0, 0, 0), "quaternion", "length 0"),
    (lambda c: gl.Quaternion.from_matrix(np.diag([1, 1, -1])), "matrix", "not a rotation"),
    (lambda c: gl.RigidTransform(Q, [1, 2]), "translation", r"\(2,\), must be \(3,\)"),
    (lambda c: gl.SimilarityTransform(-1, Q, [0, 0, 0]), "scale", "above 0"),
    (lambda c: gl.GeodeticPosition(91, 0), "latitude_deg", "90"),
    (lambda c: gl.Image.bgr(np.zeros((4, 4, 3))), "image", "float64, must be uint8"),
    (lambda c: gl.Image.bgr(np.zeros((4, 4, 4), np.uint8)), "image", r"must be \(height, width, 3\)"),
    (lambda c: gl.Image.gray(np.zeros((0, 4), np.uint8)), "image", "no pixels"),
    (lambda c: gl.Image.of(3.5), "image", "Image, an array, or the bytes or path"),
    (lambda c: gl.Image.file("/no/such.jpg"), "image", "/no/such.jpg: cannot be read"),
    (lambda c: gl.StreamOptions(max_in_flight=257), "max_in_flight", r"in \[1, 256\]"),
    (lambda c: gl.StreamOptions(first_backoff_s=2, last_backoff_s=1), "last_backoff_s", "first_backoff_s"),
    (lambda c: gl.ClientOptions(call_timeout_s=0), "call_timeout_s", "above 0"),
    (lambda c: gl.ClientOptions(token="two\nlines"), "token", "printable"),
    (lambda c: gl.Client("localhost"), "server", "HOST:PORT"),
    (lambda c: gl.Client("localhost:99999"), "server", "HOST:PORT"),
    (lambda c: gl.connect("localhost:1", tls=gl.TLS(ca="/no/ca.pem")), "tls.ca", "cannot be read"),
    (lambda c: gl.connect("localhost:1", tls=gl.TLS(cert=__file__)), "tls.key", "go together"),
    (lambda c: gl.connect("localhost:1", tls=gl.TLS(ca=__file__)), "tls.ca", "not a PEM"),
    (lambda c: gl.connect("localhost:1", token_file="/no/token"), "token_file", "cannot be read"),
    (lambda c: gl.Video("/no/such.mp4"), "video", "no such file"),
    (lambda c: gl.Video(__file__), "video", "not readable as a video"),
    (lambda c: gl.track("x.mp4", map="yard", box=(1, 2, 3)), "box", r"must be \(4,\)"),
    (lambda c: gl.track("x.mp4", map="yard", box=(1, 2, 0, 4)), "box.width", "above 0"),
    (lambda c: gl.track("x.mp4", map="-yard", box=(1, 2, 3, 4)), "map", "not start with"),
    (lambda c: gl.track("x.mp4", map="yard", box_frame=3), "box_frame", "missing"),
    (lambda c: gl.track("x.mp4", map="yard", box=(1, 2, 3, 4), box_frame=9, last=5), "box_frame", "not among"),
    (lambda c: gl.track("x.mp4", map="yard", targets={"a b": (1, 2, 3, 4)}), r"targets\['a b'\]", "A-Z"),
    (lambda c: gl.track("x.mp4", map="yard", imu="imu.json"), "inertial", "missing: imu needs it"),
    (lambda c: gl.track("x.mp4", map="yard", imu=5, inertial="data.csv"), "imu", "ImuModel or the path"),
    (lambda c: gl.ImuModel(Q, gyroscope_bias_rad_s=-1), "imu.gyroscope_bias_rad_s", "not be negative"),
    (lambda c: gl.InertialSamples([2, 1], np.zeros((2, 3)), np.zeros((2, 3))), "inertial.time_ns", r"1 \(row 1\) is not above 2"),
    (lambda c: gl.InertialSamples([0.5], np.zeros((1, 3)), np.zeros((1, 3))), "inertial.time_ns", "whole numbers"),
    (lambda c: gl.InertialSamples([1, 2], np.zeros((2, 3)), np.zeros((1, 3))), "inertial.acceleration_m_s2", r"must be \(2, 3\)"),
    (lambda c: gl.InertialSamples([1], [[0, 0, np.inf]], np.zeros((1, 3))), "inertial.angular_rate_rad_s", "not finite"),
    # Calls of the client.
    (lambda c: c.get_map("a/b"), "name", "A-Z a-z 0-9"),
    (lambda c: c.get_map("yard", -1), "version", "0 or more"),
    (lambda c: c.point_cloud("yard", max_points=1.5), "max_points", "whole number"),
    (lambda c: c.export_map("yard", "/tmp/x", format="col"), "format", "one of colmap, colmap-text"),
    (lambda c: c.import_map("yard", "/no/such"), "path", "no such file or folder"),
    (lambda c: c.import_map("yard", "/tmp", format="colmapp"), "format", "did you mean 'colmap'"),
    (lambda c: c.import_map("yard", __file__), "path", "expected a folder with a COLMAP model"),
    (lambda c: c.build_map("yard"), "video", "either a video or images"),
    (lambda c: c.build_map("yard", video="/no/such.mp4"), "video", "no such file"),
    (lambda c: c.align_map("yard", 5), "method", "KnownDistance"),
    (lambda c: c.align_map("yard", gl.CameraPositions({})), "positions", "3 or more"),
    (lambda c: c.align_map("yard", gl.KnownDistance(gl.MapPoint(), gl.MapPoint(), 1)), "start", "position_world, or pixels"),
    (lambda c: c.align_map("yard", ground="auto"), "ground", "'automatic'"),
    (lambda c: c.align_map("yard", ground=gl.Terrain([1, 2], 0, 0, 1)), "ground.z_m", "at least 3 x 3"),
    (lambda c: c.create_session(map="yard", camera=5), "camera", "CameraModel or the path"),
    (lambda c: gl.connect("localhost:1", local=True), "server", "local=True"),
    (lambda c: gl.connect(local=True, tls=gl.TLS()), "tls", "local=True"),
    (lambda c: gl.Client("http://localhost:50551"), "server", "grpcs://HOST:PORT"),
    (lambda c: c.create_session(map="yard", camera="/no/camera.json"), "/no/camera.json", "cannot be read"),
    (lambda c: c.create_session(map=None, camera=camera(), session_id="a b"), "session_id", "A-Z"),
    (lambda c: c.create_session(map=None, camera=camera(), options=gl.SessionOptions(flow_mode="liv")), "options.flow_mode", "did you mean 'live'"),
    (lambda c: c.create_session(map=None, camera=camera(), options=gl.SessionOptions(confidence_threshold=1)), "options.confidence_threshold", r"\(0, 1\)"),
    (lambda c: c.create_session(map=None, camera=camera(), options=gl.SessionOptions(camera_lost_after_s=-1)), "options.camera_lost_after_s", r"\[0, 86400\]"),
    (lambda c: c.localize(b"x", map="yard", camera=camera(), prior=gl.PosePrior(position_m=(0, 0, 0))), "prior.position_sigma_m", "needs it, above 0"),
    (lambda c: c.localize(b"x", map="yard", camera=camera(), prior=gl.PosePrior(rotation_sigma_rad=1.0)), "prior.rotation", "missing"),
    (lambda c: c.localize(b"x", map="yard", camera=camera(), prior=gl.PosePrior((0, 0, 0), 1, gl.GeodeticPosition(0, 0), 1)), "prior.geodetic_position", "not together"),
    (lambda c: c.localize(b"x", map="yard", camera=camera(), prior=gl.PosePrior(position_arm_m=(0, 0, 0))), "prior.position_arm_m", "goes with"),
    (lambda c: c.localize(b"x", map="yard", camera=camera(), prior=gl.PosePrior((0, 0, 0), 1, position_arm_m=(0, 0))), "prior.position_arm_m", "3|three"),
]


@pytest.mark.parametrize("case", range(len(LOCAL)))
def test_refused_here(client, case):
    call, field, words = LOCAL[case]
    with pytest.raises(gl.GroundlockError, match=words) as caught:
        call(client)
    assert caught.value.code in (gl.Code.INVALID_ARGUMENT, gl.Code.NOT_FOUND)
    assert caught.value.field is not None
    assert re.fullmatch(field, caught.value.field)
    assert caught.value.field in str(caught.value)


def test_sessions_refuse_here(client):
    with client.create_session(map=None, camera=camera()) as session:
        for call, field in (
            (lambda: session.set_target("a b", (1, 1, 2, 2)), "target_id"),
            (lambda: session.set_target("car", (1, 1, -2, 2)), "box.width"),
            (lambda: session.set_target("car", (1, 1, 2, np.inf)), "box"),
            (lambda: session.set_target("car", "box"), "box"),
            (lambda: session.set_target("car", (1, 1, 2, 2), sequence=-1), "sequence"),
            (lambda: session.set_target("car", (1, 1, 2, 2), body="tank"), "body.kind"),
            (lambda: session.set_target("car", (1, 1, 2, 2), body=3), "body"),
            (
                lambda: session.set_target(
                    "car", (1, 1, 2, 2), body=gl.TargetBody(size_m=(1, 2))
                ),
                "body.size_m",
            ),
            (
                lambda: session.set_target(
                    "car", (1, 1, 2, 2), body=gl.TargetBody("car", (4, 2, 0))
                ),
                "body.size_m",
            ),
            (lambda: session.move_target("", (1, 1, 2, 2)), "target_id"),
            (lambda: session.watch(image_width_px=-1), "image_width_px"),
        ):
            with pytest.raises(gl.InvalidArgumentError) as caught:
                call()
            assert caught.value.field == field
        # The server knows what is too large.
        with pytest.raises(gl.InvalidArgumentError, match="body.size_m.z: 501"):
            session.set_target(
                "car", (1, 1, 2, 2), body=gl.TargetBody("car", (4, 2, 501))
            )
        with session.stream() as stream:
            for frame, field in (
                (gl.Frame(np.zeros((480, 640, 2), np.uint8)), "frame.image"),
                (gl.Frame(np.zeros((480, 640), np.uint8), sequence=-1), "frame.sequence"),
                (gl.Frame(np.zeros((480, 640), np.uint8), capture_time_ns=-1), "frame.capture_time_ns"),
                (gl.Frame(np.zeros((480, 640), np.uint8), camera="x.json"), "x.json"),
                (gl.Frame(np.zeros((480, 640), np.uint8), inertial=[1, 2]), "frame.inertial"),
                (gl.Frame(np.zeros((480, 640), np.uint8), inertial=gl.InertialSamples(
                    np.arange(4097), np.zeros((4097, 3)), np.zeros((4097, 3)))), "frame.inertial"),
            ):
                with pytest.raises(gl.InvalidArgumentError) as caught:
                    stream.send(frame)
                assert caught.value.field == field
            # None of these has cost a sequence number.
            assert stream.send(np.zeros((480, 640), np.uint8)) == 0
            with pytest.raises(gl.InvalidArgumentError, match="0 is below 1"):
                stream.send(gl.Frame(np.zeros((480, 640), np.uint8), sequence=0))


def test_refused_by_the_server(client, frames):
    """Its messages name the field, too; the kinds are the same."""
    with pytest.raises(gl.NotFoundError, match="nowhere"):
        client.get_map("nowhere")
    with pytest.raises(gl.NotFoundError, match="nowhere"):
        client.create_session(map="nowhere", camera=camera())
    with pytest.raises(gl.InvalidArgumentError, match="tracker.*dcf"):
        client.create_session(map=None, camera=camera(), options=gl.SessionOptions(tracker="none"))
    with pytest.raises(gl.NotFoundError):
        client.session("nobody")
    with client.create_session(map=None, camera=camera(), session_id="taken") as session:
        with pytest.raises(gl.AlreadyExistsError, match="taken"):
            client.create_session(map=None, camera=camera(), session_id="taken")
        with pytest.raises(gl.NotFoundError, match="car"):
            session.move_target("car", (1, 1, 2, 2))
        with pytest.raises(gl.NotFoundError, match="car"):
            session.drop_target("car")
    with pytest.raises(gl.InvalidArgumentError, match="image"):
        client.localize(b"no picture", map="yard", camera=camera())
