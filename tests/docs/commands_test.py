#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs the commands of the documents, as they are written.

    commands_test.py BUILD [DOCUMENT ...]
    commands_test.py --scripts FOLDER DOCUMENT   write them there: LINE.sh

Every ```sh block of README.md and docs/*.md is run by bash in a folder with the
files that the documents speak of, unless a line above it says why not:

    <!-- not run: REASON -->      it cannot be run here
    <!-- run by TEST -->          that CTest runs the same

Of a block with such a line above it

    <!-- its servers are ended afterwards -->

the servers and dashboards run beside the commands that follow them, and have to end
well when the block is over; one that is started again takes the place of the first.

A document's blocks run one after the other on the same maps. All of it happens in
a network of its own, so that no server of this machine is met, and with folders of
its own for what services write. Exits with 77 where that cannot be had.
"""
from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MARK = re.compile(r"<!-- (?:not run: (?P<reason>\S.*)|run by (?P<test>\S+)|(?P<servers>its servers are ended afterwards)) -->")
LIMIT_S = 900
# Names of the documents that stand for this machine.
HOSTS = "127.0.0.1 localhost\n127.0.0.1 server.example\n"
# Stands in the PATH before the program: comes back once that serves.
STARTER = """#!/usr/bin/env bash
set -euo pipefail
program=$(basename "$0")
state=$SERVERS/$program
if [ -f "$state.pid" ]; then
  kill -TERM "$(cat "$state.pid")"
  until [ -s "$state.code" ]; do sleep 0.1; done
  [ "$(cat "$state.code")" = 0 ] || { echo "$program ended badly"; cat "$state.log"; exit 1; }
  rm "$state.pid" "$state.code"
fi
: >"$state.log"
(
  code=0
  bash -c 'echo $$ >"$0"; exec "$@"' "$state.pid" "$PROGRAMS/$program" "$@" >"$state.log" 2>&1 || code=$?
  echo "$code" >"$state.code"
) &
until grep -qE 'listening on|serving https?://' "$state.log"; do
  if [ -s "$state.code" ]; then cat "$state.log"; exit 1; fi
  sleep 0.1
done
"""


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
    (folder / "videos").mkdir()
    (folder / "videos" / "drive.mp4").symlink_to(folder / "drive.mp4")
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


class Servers:
    """The servers and dashboards of a block, which run beside its other commands."""

    def __init__(self, folder: Path, programs: Path, env):
        self.folder, self.programs, self.env_without = folder, programs, env
        folder.mkdir()
        for name in ("groundlock-server", "groundlock-dashboard"):
            (folder / name).write_text(STARTER)
            (folder / name).chmod(0o755)
        (folder / "grpcurl").symlink_to(ROOT / "tests" / "docs" / "grpcurl.py")  # Debian 12 has none

    def env(self):
        return {**self.env_without, "PATH": f"{self.folder}:{self.env_without['PATH']}",
                "SERVERS": str(self.folder), "PROGRAMS": str(self.programs)}

    def end(self, page: Path, line: int) -> None:
        started = sorted(self.folder.glob("*.pid"))
        if not started:
            fail(page, line, "the block starts no server")
        for pid in reversed(started):  # servers after their dashboards
            code = pid.with_suffix(".code")
            if not code.exists():
                os.kill(int(pid.read_text()), signal.SIGTERM)
            for _ in range(600):
                if code.exists() and code.read_text():
                    break
                time.sleep(0.1)
            if not code.exists() or code.read_text() != "0\n":
                fail(page, line, f"{pid.stem} did not end well: {pid.with_suffix('.log').read_text()[-4000:]}")
            pid.unlink()
            code.unlink()


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
        own = 'ip link set lo up && for d in /var/lib /var/cache; do mount -t tmpfs tmpfs $d; done &&' \
            ' printf "$1" >/var/lib/hosts && mount --bind /var/lib/hosts /etc/hosts && shift && exec "$@"'
        command = ["unshare", "-rnm", "bash", "-c", own, "bash", HOSTS]
        if subprocess.run([*command, "true"], capture_output=True).returncode != 0:
            print("SKIPPED: no network of its own can be had (unshare -rnm, ip)", file=sys.stderr)
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
        servers = Servers(folder / "servers", build / "bin", env)
        ran = elsewhere = 0
        for page in pages:
            runnable = [(line, bool(mark), code) for p, line, mark, code in found
                        if p == page and not (mark and not mark["servers"])]
            elsewhere += sum(1 for p, _, mark, _ in found if p == page and mark and not mark["servers"])
            if not runnable:
                continue
            if not any((folder / "files").iterdir()):
                make_files(folder / "files", env)
            place = folder / page.stem
            shutil.copytree(folder / "files", place, symlinks=True)
            (place / "deploy").symlink_to(ROOT / "deploy")
            env["XDG_DATA_HOME"] = str(place / "data")
            for line, serves, code in runnable:
                print(f"{page.name}:{line}", flush=True)
                log = folder / "log"
                with open(log, "w") as out:
                    done = subprocess.run(
                        ["timeout", "--kill-after=10", str(LIMIT_S), "bash", "-euo", "pipefail", "-c", code],
                        cwd=place, env=servers.env() if serves else env, stdin=subprocess.DEVNULL, stdout=out,
                        stderr=subprocess.STDOUT)
                if serves:
                    servers.end(page, line - 1)
                if done.returncode != 0:
                    print(log.read_text()[-4000:], file=sys.stderr)
                    fail(page, line - 1, f"the commands ended with {done.returncode}")
                ran += 1
    print(f"commands: {ran} blocks were run, {elsewhere} say why not or where")
    return 0


if __name__ == "__main__":
    sys.exit(main())
