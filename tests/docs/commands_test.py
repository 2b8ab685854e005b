#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs the commands of the documents, as they are written.

    commands_test.py BUILD [DOCUMENT ...]
    commands_test.py --scripts FOLDER DOCUMENT   write them there: LINE.sh

Every ```sh block of README.md and docs/*.md is run by bash in a folder with the
files that the documents speak of, unless a line above it says why not:

    <!-- not run: REASON -->      it cannot be run here
    <!-- run by TEST -->          that CTest runs the same

A document's blocks run one after the other on the same maps. All of it happens in
a network of its own, so that no server of this machine is met. Exits with 77 where
that cannot be had.
"""
from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MARK = re.compile(r"<!-- (?:not run: (?P<reason>\S.*)|run by (?P<test>\S+)) -->")
LIMIT_S = 900


def blocks(page: Path):
    """(line, mark or None, commands) of each block of the page."""
    lines = page.read_text().splitlines()
    for i, line in enumerate(lines):
        if line.startswith("```sh"):
            if line != "```sh":
                fail(page, i, f"the block is marked by '{line}', and not by a comment above it")
            above = lines[i - 1] if i else ""
            mark = MARK.fullmatch(above)
            if above.startswith("<!--") and not mark:
                fail(page, i, "the comment above is neither 'not run: REASON' nor 'run by TEST'")
            yield i + 1, mark, "\n".join(lines[i + 1 : lines.index("```", i + 1)])


def fail(page: Path, line: int, words: str) -> None:
    sys.exit(f"FAILED: {page.relative_to(ROOT)}:{line + 1}: {words}")


def run(command, **options) -> None:
    done = subprocess.run(command, capture_output=True, text=True, **options)
    if done.returncode != 0:
        sys.exit(f"FAILED: {command}: {done.stdout}{done.stderr}")


def make_files(folder: Path, env) -> None:
    """The files of the documents: a map with its lens, a drive, photos, a store with a map."""
    def simulate(sequence, out, *more):
        run(["groundlock", "simulate", "yard", sequence, "--out", folder / out, "--samples", "1", *more], env=env)

    simulate("mapping", "made", "--size", "640x360")
    simulate("occlusion", "drive", "--frames", "32")  # in the size of the guide's boxes
    (folder / "drive" / "occlusion.mp4").rename(folder / "drive.mp4")
    (folder / "drive" / "camera.json").rename(folder / "camera.json")
    shutil.rmtree(folder / "drive")
    (folder / "made" / "map").rename(folder / "reconstruction")
    (folder / "made" / "align.json").rename(folder / "align.json")
    own = {**env, "XDG_DATA_HOME": str(folder / "made")}
    run(["groundlock", "map", "import", "stored", folder / "reconstruction", "--local"], env=own)
    (folder / "made" / "groundlock" / "maps").rename(folder / "store")
    shutil.rmtree(folder / "made")
    (folder / "model").mkdir()
    (folder / "model" / "0").symlink_to(folder / "reconstruction" / "sparse" / "0")
    (folder / "work").mkdir()
    (folder / "work" / "database.db").symlink_to(folder / "reconstruction" / "database.db")
    for name, count in (("photos", 3), ("frames", 30)):
        (folder / name).mkdir()
        run(
            ["ffmpeg", "-v", "error", "-i", folder / "drive.mp4", "-frames:v", str(count), "-q:v", "2",
             folder / name / "%04d.jpg"],
        )
    shutil.copyfile(folder / "photos" / "0001.jpg", folder / "photo.jpg")


def write_scripts(folder: Path, page: Path) -> int:
    folder.mkdir(parents=True)
    for line, mark, code in blocks(page):
        if not mark:
            (folder / f"{line:04d}.sh").write_text(code + "\n")
    return 0


def main() -> int:
    if sys.argv[1] == "--scripts":
        return write_scripts(Path(sys.argv[2]), Path(sys.argv[3]).absolute())
    build = Path(sys.argv[1]).absolute()
    pages = [Path(p).absolute() for p in sys.argv[2:]] or [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    if os.environ.get("GROUNDLOCK_OWN_NETWORK") != "1":
        command = ["unshare", "-rn", "bash", "-c", 'ip link set lo up && exec "$@"', "bash"]
        if subprocess.run([*command, "true"], capture_output=True).returncode != 0:
            print("SKIPPED: no network of its own can be had (unshare -rn, ip)", file=sys.stderr)
            return 77
        os.environ["GROUNDLOCK_OWN_NETWORK"] = "1"
        os.execvp(command[0], [*command, sys.executable, *sys.argv])

    tests = set(re.findall(r"Test\s+#\d+: (\S+)", subprocess.run(
        ["ctest", "-N"], cwd=build, check=True, capture_output=True, text=True).stdout))
    found = [(page, *block) for page in pages for block in blocks(page)]
    for page, line, mark, _ in found:
        if mark and mark["test"] and mark["test"] not in tests:
            fail(page, line - 1, f"there is no test {mark['test']}")

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        env = {k: v for k, v in os.environ.items() if k != "GROUNDLOCK_TOKEN"}
        env["PATH"] = f"{build / 'bin'}:{env['PATH']}"
        (folder / "files").mkdir()
        ran = elsewhere = 0
        for page in pages:
            runnable = [(line, code) for p, line, mark, code in found if p == page and not mark]
            elsewhere += sum(1 for p, _, mark, _ in found if p == page and mark)
            if not runnable:
                continue
            if not any((folder / "files").iterdir()):
                make_files(folder / "files", env)
            place = folder / page.stem
            shutil.copytree(folder / "files", place, symlinks=True)
            (place / "deploy").symlink_to(ROOT / "deploy")
            env["XDG_DATA_HOME"] = str(place / "data")
            for line, code in runnable:
                print(f"{page.name}:{line}", flush=True)
                log = folder / "log"
                with open(log, "w") as out:
                    done = subprocess.run(
                        ["timeout", "--kill-after=10", str(LIMIT_S), "bash", "-euo", "pipefail", "-c", code],
                        cwd=place, env=env, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT)
                if done.returncode != 0:
                    print(log.read_text()[-4000:], file=sys.stderr)
                    fail(page, line - 1, f"the commands ended with {done.returncode}")
                ran += 1
    print(f"commands: {ran} blocks were run, {elsewhere} say why not or where")
    return 0


if __name__ == "__main__":
    sys.exit(main())
