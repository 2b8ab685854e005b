# SPDX-License-Identifier: Apache-2.0
"""Maps through the real server: in, out, aligned, deleted."""
from __future__ import annotations

import shutil

import numpy as np
import pytest

import groundlock as gl


class Stop(Exception):
    pass


def test_import_tells_how_far_it_is(client, scene):
    steps = []
    report = client.import_map(
        "imported", scene.map, align=str(scene.align), on_progress=steps.append
    )
    assert report.map.name == "imported" and report.map.version == 1
    assert report.map.metric and report.map.has_descriptors
    # The similarity that was given is the one that the map has.
    align = gl.SimilarityTransform.read(scene.align)
    np.testing.assert_allclose(
        report.map.world_from_source.to_matrix(), align.to_matrix(), atol=1e-9
    )
    assert all(0 <= s.fraction <= 1 and s.bytes_total > 0 for s in steps)
    assert [s.bytes_done for s in steps] == sorted(s.bytes_done for s in steps)
    assert client.import_map("imported", scene.map).map.version == 2
    assert not client.get_map("imported").metric
    assert client.get_map("imported", 1) == report.map
    names = [m.name for m in client.list_maps()]
    assert names == sorted(names) and {"imported", "yard"} <= set(names)
    assert client.check_map("imported").problems == ()
    client.delete_map("imported")
    with pytest.raises(gl.NotFoundError):
        client.get_map("imported")


def test_a_callback_that_raises_ends_the_import(client, scene):
    def stop(progress):
        raise Stop

    with pytest.raises(Stop):
        client.import_map("stopped", scene.map, on_progress=stop)
    with pytest.raises(gl.NotFoundError):
        client.get_map("stopped")


def test_a_damaged_model_is_named(client, scene, tmp_path):
    shutil.copytree(scene.map, tmp_path / "map")
    broken = next(tmp_path.rglob("points3D.bin"), None) or next(tmp_path.rglob("points3D.txt"))
    broken.write_bytes(broken.read_bytes()[:1000])
    with pytest.raises(gl.GroundlockError, match="points3D") as caught:
        client.import_map("damaged", tmp_path / "map")
    assert caught.value.code in (gl.Code.INVALID_ARGUMENT, gl.Code.DATA_LOSS)
    with pytest.raises(gl.NotFoundError):
        client.get_map("damaged")


def test_points_and_mapping_images(client):
    info = client.get_map("yard")
    cloud = client.point_cloud("yard")
    assert cloud.xyz_world.shape == cloud.rgb.shape == (info.num_landmarks, 3)
    assert len(cloud.cameras) == info.num_views
    assert np.abs(np.median(cloud.xyz_world[:, 2])) < 5
    some = client.point_cloud("yard", max_points=100)
    assert 0 < len(some.xyz_world) <= 100
    camera = cloud.cameras[0]
    # Mapping cameras look at the points: most lie before them.
    ahead = camera.world_from_camera.inverse().apply(cloud.xyz_world)[:, 2] > 0
    assert ahead.mean() > 0.5


@pytest.mark.parametrize("kind", ["groundlock", "colmap", "nvm", "ply"])
def test_exports(client, tmp_path, kind):
    target = tmp_path / ("out.glmap" if kind == "groundlock" else f"out.{kind}")
    steps = []
    client.export_map("yard", target, format=kind, on_progress=steps.append)
    assert steps[-1].fraction == 1.0
    assert list(tmp_path.glob(".groundlock-*")) == []
    with pytest.raises(gl.AlreadyExistsError):
        client.export_map("yard", target, format=kind)
    if kind == "ply":
        assert target.read_bytes().startswith(b"ply")
        return
    again = client.import_map("again", target)
    assert again.map.num_landmarks == client.get_map("yard").num_landmarks
    if kind == "groundlock":
        assert again.map.content_hash == client.get_map("yard").content_hash
    client.delete_map("again")


def test_an_export_that_is_stopped_leaves_nothing(client, tmp_path):
    def stop(progress):
        raise Stop

    with pytest.raises(Stop):
        client.export_map("yard", tmp_path / "out", on_progress=stop)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(gl.NotFoundError):
        client.export_map("nowhere", tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_alignments(client, scene):
    client.import_map("plain", scene.map, align=scene.align)
    cloud = client.point_cloud("plain")
    a, b = cloud.cameras[0], cloud.cameras[-1]
    start, end = a.world_from_camera.translation, b.world_from_camera.translation
    report = client.align_map(
        "plain",
        gl.KnownDistance(gl.MapPoint(start), gl.MapPoint(end), 2 * np.linalg.norm(end - start)),
        report_only=True,
    )
    assert np.isclose(report.new_world_from_world.scale, 2)
    assert client.get_map("plain").version == 1  # nothing was published
    # Everything moved by a known similarity, told by where images were taken.
    move = gl.SimilarityTransform(1.5, gl.Quaternion.from_rotation_vector([0, 0, 0.7]), [10, -4, 0])
    places = {c.name: move.apply(c.world_from_camera.translation) for c in cloud.cameras}
    report = client.align_map("plain", gl.CameraPositions(places, accuracy_m=0.1))
    assert report.map.version == 2 and report.rms_error_m < 1e-3
    assert len(report.residuals) == len(places) and all(r.used for r in report.residuals)
    # Levelled on the ground besides: the scale is what was given.
    assert np.isclose(report.new_world_from_world.scale, 1.5, rtol=1e-3)
    origin = gl.GeodeticPosition(58.4, 15.6, 80)
    report = client.align_map("plain", gl.NewWorldFromWorld(move.inverse()), origin=origin)
    assert report.map.origin == origin and report.map.metric
    assert report.terrain is None and not report.map.ground_relief_given
    # A terrain 5 m below the yard, which is level: moved up to its ground.
    heights = np.full((41, 41), -5.0)
    terrain = gl.Terrain(heights, -40, -40, 2, fit_height=True)
    report = client.align_map("plain", ground=terrain)
    assert report.map.ground_relief_given
    assert report.terrain is not None and np.isclose(report.terrain.offset_m, 5, atol=0.3)
    points = [gl.ControlPoint(n, gl.MapPoint(p), p + [1, 2, 0]) for n, p in list(
        (c.name, c.world_from_camera.translation) for c in client.point_cloud("plain").cameras)[:6]]
    report = client.align_map("plain", gl.ControlPoints(points), ground="automatic", report_only=True)
    assert report.rms_error_m < 0.05
    client.delete_map("plain")


def test_an_alignment_tells_that_it_works(client, scene, monkeypatch):
    """It has no stages; a callback is asked now and then, and may end it."""
    from groundlock import client as module

    monkeypatch.setattr(module, "_POLL_S", 1e-4)
    client.import_map("slow", scene.map, align=scene.align)
    told = []
    double = gl.SimilarityTransform(2.0, gl.Quaternion.identity(), [0, 0, 0])
    client.align_map("slow", gl.NewWorldFromWorld(double), on_progress=told.append)
    assert client.get_map("slow").version == 2
    assert {p.stage for p in told} == {"aligning"}

    def stop(progress):
        raise Stop

    with pytest.raises(Stop):
        client.align_map("slow", gl.NewWorldFromWorld(double), on_progress=stop)
    client.delete_map("slow")


def test_a_build_that_cannot_succeed_says_why(client, scene, tmp_path):
    photos = sorted(scene.folder.glob("mapping/**/*.jpg"))[:1]
    if not photos:
        pytest.skip("the scene has no mapping images")
    with pytest.raises(gl.GroundlockError) as caught:
        client.build_map("single", images=photos)
    assert caught.value.code in (gl.Code.FAILED_PRECONDITION, gl.Code.INVALID_ARGUMENT)
    with pytest.raises(gl.NotFoundError):
        client.get_map("single")


def test_builds_tell_their_stages(client, scene):
    steps = []

    def seen(progress):
        steps.append(progress)
        # Further than the upload: that it ends is what map_build tests.
        if progress.stage not in ("uploading", "preparing"):
            raise Stop

    with pytest.raises(Stop):
        client.build_map("building", video=scene.video, max_images=8, on_progress=seen)
    assert steps[-1].stage and 0 <= steps[-1].fraction <= 1
    with pytest.raises(gl.NotFoundError):
        client.get_map("building")


def test_single_images_are_localised(client, camera, frames, scene):
    report = client.localize(frames[0].image, map="yard", camera=camera)
    assert report.camera.state is gl.CameraState.TRACKED
    truth = np.array([float(scene.truth[0][f"cam_{n}"]) for n in "xyz"])
    found = report.camera.world_from_camera
    assert np.linalg.norm(found.translation - truth) < 0.1
    prior = gl.PosePrior(truth, 1.0, rotation=found.rotation, rotation_sigma_rad=0.1)
    again = client.localize(frames[0].image, map="yard", camera=str(scene.camera), prior=prior)
    assert np.linalg.norm(again.camera.world_from_camera.translation - truth) < 0.1
    geodetic = gl.PosePrior(geodetic_position=gl.GeodeticPosition(1, 2), geodetic_sigma_m=5)
    with pytest.raises(gl.FailedPreconditionError, match="prior|georef|origin"):
        client.localize(frames[0].image, map="yard", camera=camera, prior=geodetic)
    blank = np.zeros((camera.height_px, camera.width_px), np.uint8)
    nothing = client.localize(blank, map="yard", camera=camera).camera
    assert nothing.state is gl.CameraState.LOST and nothing.world_from_camera is None
