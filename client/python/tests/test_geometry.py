# SPDX-License-Identifier: Apache-2.0
"""Conversions against NumPy's own algebra, and what is refused."""
from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

import groundlock as gl
from groundlock import _convert


@pytest.fixture
def random():
    return np.random.default_rng(7)


def rotation(random):
    """A uniformly random rotation matrix, made without quaternions."""
    q, r = np.linalg.qr(random.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else q[:, ::-1]


def test_quaternions_and_matrices_agree(random):
    half_turns = [np.diag(d) for d in ([1, -1, -1], [-1, 1, -1], [-1, -1, 1])]
    for matrix in [rotation(random) for _ in range(200)] + half_turns + [np.eye(3)]:
        q = gl.Quaternion.from_matrix(matrix)
        assert np.isclose(q.w**2 + q.x**2 + q.y**2 + q.z**2, 1, atol=1e-14)
        np.testing.assert_allclose(q.to_matrix(), matrix, atol=1e-12)
        np.testing.assert_allclose(q.inverse().to_matrix(), matrix.T, atol=1e-12)


def test_rotation_vectors():
    quarter = gl.Quaternion.from_rotation_vector([0, 0, np.pi / 2])
    np.testing.assert_allclose(quarter.to_matrix() @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    assert gl.Quaternion.from_rotation_vector([0, 0, 0]) == gl.Quaternion.identity()
    assert np.isclose(quarter.angle_to(gl.Quaternion.identity()), np.pi / 2)
    a = gl.Quaternion.from_rotation_vector([0.3, -1.1, 0.4])
    b = gl.Quaternion.from_rotation_vector([-0.2, 0.1, 2.0])
    np.testing.assert_allclose((a @ b).to_matrix(), a.to_matrix() @ b.to_matrix(), atol=1e-14)


def test_rigid_transforms_compose_as_matrices(random):
    def transform():
        return gl.RigidTransform(gl.Quaternion.from_matrix(rotation(random)), random.normal(size=3))

    a_from_b, b_from_c = transform(), transform()
    np.testing.assert_allclose(
        (a_from_b @ b_from_c).to_matrix(), a_from_b.to_matrix() @ b_from_c.to_matrix(), atol=1e-12
    )
    np.testing.assert_allclose(
        (a_from_b @ a_from_b.inverse()).to_matrix(), np.eye(4), atol=1e-12
    )
    points = random.normal(size=(5, 4, 3))
    there = a_from_b.apply(points)
    expected = points @ a_from_b.to_matrix()[:3, :3].T + a_from_b.to_matrix()[:3, 3]
    np.testing.assert_allclose(there, expected, atol=1e-12)
    again = gl.RigidTransform.from_matrix(a_from_b.to_matrix())
    np.testing.assert_allclose(again.to_matrix(), a_from_b.to_matrix(), atol=1e-12)


def test_similarities(random):
    s = gl.SimilarityTransform(2.5, gl.Quaternion.from_matrix(rotation(random)), [1, 2, 3])
    points = random.normal(size=(6, 3))
    np.testing.assert_allclose(s.inverse().apply(s.apply(points)), points, atol=1e-12)
    homogeneous = np.c_[points, np.ones(6)] @ s.to_matrix().T
    np.testing.assert_allclose(s.apply(points), homogeneous[:, :3], atol=1e-12)


def test_values_are_frozen_and_compare():
    pose = gl.RigidTransform(gl.Quaternion(2, 0, 0, 0), [1, 2, 3])
    assert pose.rotation.w == 1.0
    assert pose == gl.RigidTransform(gl.Quaternion.identity(), (1, 2, 3))
    assert pose != gl.RigidTransform(gl.Quaternion.identity(), (1, 2, 4))
    with pytest.raises(dataclasses.FrozenInstanceError):
        pose.translation = np.zeros(3)
    with pytest.raises(ValueError):
        pose.translation[0] = 5


def test_boxes():
    box = gl.Box2(10, 20, 30, 40)
    assert box.center == (25, 40)
    assert box.iou(box) == 1 and box.iou(gl.Box2(50, 20, 5, 5)) == 0
    assert np.isclose(box.iou(gl.Box2(25, 20, 30, 40)), 15 / 45)
    turned = gl.Quaternion.from_rotation_vector([0, 0, np.pi / 2])
    corners = gl.Box3(gl.RigidTransform(turned, [1, 1, 0.5]), [4, 2, 1]).corners()
    np.testing.assert_allclose(corners.min(axis=0), [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(corners.max(axis=0), [2, 3, 1], atol=1e-12)
    assert (corners[:4, 2] == 0).all()


def test_camera_files(tmp_path):
    camera = gl.CameraModel("OPENCV", 640, 480, (500, 501, 320, 240, 0.1, 0, 0, 0))
    camera.write(tmp_path / "camera.json")
    assert gl.CameraModel.read(tmp_path / "camera.json") == camera
    assert set(json.loads((tmp_path / "camera.json").read_text())) == {"width", "height", "model", "params"}
    message = _convert.camera_to(camera)
    assert _convert.camera_from(message) == camera
    assert set(gl.CAMERA_MODELS) == set(_convert._CAMERA_MODELS)


def test_every_word_of_the_protocol_is_known():
    """What the protocol may say has a name here."""
    from groundlock.v1 import geometry_pb2, maps_pb2, tracking_pb2

    for enum, known in (
        (geometry_pb2.CameraModelId, _convert._CAMERA_NAMES),
        (tracking_pb2.CameraState, _convert._CAMERA_STATES),
        (tracking_pb2.TargetState, _convert._TARGET_STATES),
        (tracking_pb2.FrameDropped.Reason, _convert._DROP_REASONS),
        (tracking_pb2.ImageEncoding, _convert._ENCODINGS.values()),
        (tracking_pb2.FlowMode, _convert._FLOW_MODES.values()),
        (maps_pb2.MapFormat, _convert._FORMATS.values()),
        (maps_pb2.MapExportFormat, _convert._EXPORT_FORMATS.values()),
        (maps_pb2.GroundState, _convert._GROUND_STATES),
    ):
        assert set(enum.values()) - {0} <= set(known), enum.DESCRIPTOR.full_name


def test_messages_keep_every_digit(random):
    pose = gl.RigidTransform(gl.Quaternion.from_matrix(rotation(random)), random.normal(size=3))
    wire = _convert.geometry_pb2.RigidTransform(
        rotation=_convert.quaternion_to(pose.rotation),
        translation=_convert.vector_to("t", pose.translation),
    )
    back = _convert.rigid_from(type(wire).FromString(wire.SerializeToString()))
    assert back == pose


@pytest.mark.parametrize("encoding", ["bgr", "rgb", "gray"])
def test_images_keep_their_pixels(random, encoding):
    shape = (6, 8) if encoding == "gray" else (6, 8, 3)
    pixels = random.integers(0, 256, shape).astype(np.uint8)
    # Rows that do not lie one after the other in memory.
    for array in (pixels, np.repeat(pixels, 2, axis=1)[:, ::2], np.asfortranarray(pixels)):
        image = getattr(gl.Image, encoding)(array)
        assert (image.width_px, image.height_px) == (8, 6)
        expected = pixels[:, :, ::-1] if encoding == "rgb" else pixels
        np.testing.assert_array_equal(image.to_array(), expected)
    message = _convert.image_to(image)
    assert _convert.image_from(message) == image


def test_compressed_images(random):
    ramp = np.linspace(0, 255, 64 * 48 * 3).astype(np.uint8).reshape(48, 64, 3)
    image = gl.Image.jpeg(ramp, quality=95)
    assert image.data[:2] == b"\xff\xd8" and len(image.data) < ramp.size
    assert np.abs(image.to_array().astype(int) - ramp).mean() < 4
    with pytest.raises(gl.DataLossError, match="image: cannot be decoded"):
        gl.Image.file(b"\xff\xd8 no picture").to_array()
