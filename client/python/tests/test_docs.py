# SPDX-License-Identifier: Apache-2.0
"""Every example of docs/python.md, and those of examples/, run."""
from __future__ import annotations

import enum
import inspect
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import groundlock
from groundlock import local_server
from support import BIN, HERE

PAGE = HERE.parents[2] / "docs" / "python.md"
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.M | re.S)


@pytest.fixture(scope="module")
def place(scene, tmp_path_factory):
    """A folder with the files that the examples speak of."""
    folder = tmp_path_factory.mktemp("docs")
    subprocess.run(
        [
            *("ffmpeg", "-v", "error", "-i", scene.video, "-frames:v", "6"),
            *("-c:v", "libx264", "-preset", "ultrafast", "-crf", "16", folder / "drive.mp4"),
        ],
        check=True,
    )
    # A unit that rests, and has the camera's axes.
    (folder / "imu.json").write_text('{"imu_from_camera_wxyz": [1, 0, 0, 0]}')
    (folder / "imu.csv").write_text("".join(f"{t},0,0,0,0,-9.8,0\n" for t in range(0, 300_000_000, 5_000_000)))
    (folder / "reconstruction").symlink_to(scene.map)
    for name in ("camera.json", "align.json"):
        (folder / name).symlink_to(scene.folder / name)
    return folder


@pytest.fixture
def fresh_shell(place, monkeypatch):
    """No server runs, whatever does on this machine."""
    monkeypatch.chdir(place)
    monkeypatch.setenv("XDG_DATA_HOME", str(place / "data"))
    monkeypatch.setenv("GROUNDLOCK_BIN", str(BIN))
    monkeypatch.setattr(local_server, "loopback_answers", lambda: False)


def test_the_page_has_examples():
    assert len(BLOCKS) >= 8


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_examples_of_the_page(number, fresh_shell, place, request, capsys):
    code = BLOCKS[number]
    if "recording.mcap" in code:
        recorded = request.getfixturevalue("recorded")  # skipped without a dashboard
        (place / "recording.mcap").write_bytes(recorded[0].read_bytes())
    exec(compile(code, f"{PAGE.name}, example {number + 1}", "exec"), {"__name__": "__main__"})
    if "results.csv" in code:
        assert len((place / "results.csv").read_text().splitlines()) == 7
        assert "TRACKED" in capsys.readouterr().out


def example(name, *arguments, **environment):
    script = HERE.parent / "examples" / name
    return subprocess.run(
        [sys.executable, script, *arguments],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=600,
    )


def test_the_opencv_loop(shared_server, scene, place, tmp_path):
    pytest.importorskip("cv2")
    box = ",".join(str(v) for v in scene.box)
    done = example(
        "opencv_loop.py", place / "drive.mp4", scene.camera, "yard", box,
        "--server", shared_server.address, "--save", tmp_path / "out.mp4",
    )
    assert done.returncode == 0, done.stderr
    assert "6 frames" in done.stdout
    with groundlock.Video(tmp_path / "out.mp4") as video:
        assert len(list(video)) == 6


def test_the_notebook(fresh_shell, place, monkeypatch, tmp_path):
    """Cell by cell, as Jupyter would; its plots have something in them."""
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    from matplotlib import pyplot

    notebook = json.loads((HERE.parent / "examples" / "drive.ipynb").read_text())
    shown = []

    def show():
        figure = pyplot.gcf()
        path = tmp_path / f"plot-{len(shown)}.png"
        figure.savefig(path)
        shown.append((path.stat().st_size, sum(len(a.lines) for a in figure.axes)))
        pyplot.close(figure)

    monkeypatch.setattr(pyplot, "show", show)
    names = {"__name__": "__main__"}
    for i, cell in enumerate(c for c in notebook["cells"] if c["cell_type"] == "code"):
        exec(compile("".join(cell["source"]), f"drive.ipynb, cell {i + 1}", "exec"), names)
        assert not cell["outputs"], "outputs are not kept in the repository"
    assert len(names["run"].results) == 6
    assert len(shown) == 2
    # From above: the camera and each place of the car.
    assert shown[0][1] > 6 and shown[1][1] == 6
    assert all(size > 10_000 for size, _ in shown)
    assert len(names["table"]) == 6


def test_a_recording_to_csv(recorded, tmp_path):
    done = example("recording_to_csv.py", recorded[0], tmp_path / "out.csv", "--images", tmp_path / "images")
    assert done.returncode == 0, done.stderr
    assert len((tmp_path / "out.csv").read_text().splitlines()) == len(recorded[1]) + 1
    assert list((tmp_path / "images").glob("*.jpg"))
    done = example("recording_to_csv.py", __file__, tmp_path / "no.csv")
    assert done.returncode == 1 and "is no MCAP file" in done.stderr
    assert not (tmp_path / "no.csv").exists()


def test_the_public_names_have_words():
    """help() is the reference: what is public says what it is."""
    for name in groundlock.__all__:
        thing = getattr(groundlock, name)
        if isinstance(thing, type) and not issubclass(thing, enum.Enum):
            words = thing.__doc__ or ""
            # What a dataclass without words is given.
            assert words and not words.startswith(f"{name}("), name
        elif inspect.isfunction(thing):
            assert thing.__doc__, name
