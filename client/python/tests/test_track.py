# SPDX-License-Identifier: Apache-2.0
"""groundlock.track: one line, the same results as the command line's."""
from __future__ import annotations

import csv
import subprocess

import numpy as np
import pytest

import groundlock as gl
from conftest import FRAMES
from support import BIN


@pytest.fixture(scope="module")
def run(shared_server, scene):
    seen = []
    result = gl.track(
        scene.video,
        map="yard",
        box=scene.box,
        camera=scene.camera,
        last=FRAMES,
        server=shared_server.address,
        on_answer=seen.append,
    )
    assert tuple(seen) == result.answers
    return result


def test_the_car_is_followed(run, scene):
    assert len(run.results) == FRAMES and not run.failed and not run.dropped
    car = run.target()
    assert len(car) == FRAMES
    truth = [gl.Box2(*(float(scene.truth[s][f"box_{n}"]) for n in "xywh")) for s, _ in car]
    assert np.mean([t.box.iou(b) for (_, t), b in zip(car, truth)]) > 0.5
    path = run.camera_path()
    assert path.shape[1] == 3 and len(path) > FRAMES // 2


def test_the_table_is_the_command_line_s(run, shared_server, scene, tmp_path):
    """The same columns, rows, digits; and the same numbers, but for what two
    decoders of the same video make of its colours."""
    run.write_csv(tmp_path / "python.csv")
    box = ",".join(str(v) for v in scene.box)
    subprocess.run(
        [
            *(BIN / "groundlock", "track", scene.video, "--map", "yard"),
            *("--camera", scene.camera, "--init-box", box, "--frames", f"0:{FRAMES}"),
            *("--results", tmp_path / "cli.csv", "--server", shared_server.address),
        ],
        check=True,
        capture_output=True,
    )
    with open(tmp_path / "cli.csv", newline="") as a, open(tmp_path / "python.csv", newline="") as b:
        ours, theirs = list(csv.DictReader(b)), list(csv.DictReader(a))
    assert list(ours[0]) == list(theirs[0]) == list(gl.tables.COLUMNS)
    assert len(ours) == len(theirs) == FRAMES
    for mine, other in zip(ours, theirs):
        assert mine["frame"] == other["frame"] and mine["t_s"] == other["t_s"]
        for name in gl.tables.COLUMNS:
            assert (mine[name] == "") == (other[name] == ""), name
            if mine[name] and "." in mine[name]:
                assert len(mine[name].partition(".")[2]) == len(other[name].partition(".")[2])
    # What is compared is where both know it well.
    for name, bound in (("cam_x", 0.05), ("cam_y", 0.05), ("cam_z", 0.05), ("box_x", 8), ("box_y", 8)):
        pairs = [(float(m[name]), float(o[name])) for m, o in zip(ours, theirs) if m[name]]
        assert np.median([abs(m - o) for m, o in pairs]) < bound, name


def test_tables(run):
    table = run.to_frame()
    assert list(table.columns) == list(gl.tables.COLUMNS)
    assert len(table) == FRAMES
    assert table.frame.tolist() == list(range(FRAMES))
    assert (table.camera_state == "TRACKED").sum() > FRAMES // 2
    assert np.isfinite(table.t_s).all()
    failed = gl.FrameFailed(7, gl.InvalidArgumentError("x"))
    rows = list(gl.tables.rows([failed], {7: 5_000_000}))
    assert rows == [{"frame": 7, "t_s": 0.005}]


def test_times_of_frames_are_the_container_s(tmp_path, scene):
    """A video whose frames are not evenly spaced."""
    uneven = tmp_path / "uneven.mkv"
    subprocess.run(
        [
            *("ffmpeg", "-v", "error", "-i", scene.video, "-frames:v", "6", "-an", "-vf"),
            *("scale=160:90,settb=1/1000,setpts=N*N*10", "-fps_mode", "passthrough"),
            *("-enc_time_base", "1:1000", uneven),
        ],
        check=True,
    )
    with gl.Video(uneven) as video:
        frames = list(video)
    assert (video.width_px, video.height_px) == (160, 90)
    assert [f.capture_time_ns for f in frames] == [n * n * 10_000_000 for n in range(6)]
    with gl.Video(uneven, first=2, last=4) as video:
        again = list(video)
    assert [f.number for f in again] == [2, 3]
    np.testing.assert_array_equal(again[0].image, frames[2].image)


def test_folders_of_images_and_cut_off_videos(client, camera, frames, scene, tmp_path):
    folder = tmp_path / "images"
    folder.mkdir()
    for frame in frames[:3]:
        (folder / f"{frame.number:03}.jpg").write_bytes(gl.Image.jpeg(frame.image).data)
    (folder / "notes.txt").write_text("no image")
    run = gl.track(folder, map="yard", camera=camera, fps=24, client=client)
    assert [a.sequence for a in run.results] == [0, 1, 2]
    assert [r.capture_time_ns for r in run.results] == [0, 41666667, 83333333]
    assert run.results[0].camera.state is gl.CameraState.TRACKED
    # A file that breaks off gives what it has, or says that it is broken.
    broken = tmp_path / "broken.mp4"
    broken.write_bytes(scene.video.read_bytes()[:5000])
    with pytest.raises(gl.GroundlockError, match="broken.mp4"):
        gl.track(broken, map="yard", camera=camera, client=client)


def test_the_lens(client, scene, camera, tmp_path):
    """Without one, the map's own is taken."""
    lens = client.get_map("yard").lens
    assert (lens.width_px, lens.height_px) == (camera.width_px, camera.height_px)
    assert np.isclose(lens.params[0], camera.params[0], rtol=0.02)
    run = gl.track(scene.video, map="yard", last=2, client=client)
    assert run.session.camera == lens and len(run.results) == 2
    assert run.results[1].camera.state is gl.CameraState.TRACKED
    other = gl.CameraModel("PINHOLE", 320, 240, (300, 300, 160, 120))
    with pytest.raises(gl.InvalidArgumentError, match="camera: is for 320x240, but frames"):
        gl.track(scene.video, map="yard", camera=other, client=client)
    small = tmp_path / "small.mp4"
    subprocess.run(
        ["ffmpeg", "-v", "error", "-i", scene.video, "-frames:v", "3", "-vf", "scale=320:240", small],
        check=True,
    )
    with pytest.raises(gl.InvalidArgumentError, match="320 x 240.*lens"):
        gl.track(small, map="yard", client=client)
    run = gl.track(small, map=None, box=(100, 100, 40, 40), client=client)
    assert len(run.results) == 3 and run.results[0].camera.world_from_camera is None
    assert run.session.camera is None
    assert run.results[0].target("target").box is not None


def test_targets_that_cannot_be_started(client, scene, camera):
    before = client.list_sessions()
    with pytest.raises(gl.InvalidArgumentError, match="target far:") as caught:
        gl.track(scene.video, map=None, camera=camera, targets={"far": (9000, 9000, 5, 5)}, client=client)
    assert caught.value.field == "targets['far']"
    targets = {"far": (9000, 9000, 5, 5), "car": (scene.box, 1)}
    run = gl.track(scene.video, map=None, camera=camera, targets=targets, last=4, client=client)
    assert set(run.target_errors) == {"far"}
    assert [s for s, _ in run.target("car")] == [1, 2, 3]
    assert client.list_sessions() == before


def test_it_starts_a_server_where_there_is_none(scene, camera, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    monkeypatch.setenv("GROUNDLOCK_BIN", str(BIN))
    with gl.connect(local=True) as client:
        client.import_map("yard", scene.map, align=scene.align)
    # Another program, later: the map is still there.
    run = gl.track(scene.video, map="yard", box=scene.box, last=3, local=True)
    assert len(run.results) == 3 and run.session.map_name == "yard"
    with pytest.raises(gl.NotFoundError, match="nowhere"):
        gl.track(scene.video, map="nowhere", box=scene.box, last=3, local=True)
