#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Tracks the same frames as several processors would and compares the results.

  tests/eval/same_result.py [--bin build/bin] [--frames N] [--sequence NAME ...] [--keep FOLDER] [MODE ...]

A mode is how server and client run, which import the map, too; the first one is what the others are compared with:
  native             as on any machine
  baseline, avx2     GROUNDLOCK_INSTRUCTIONS bounds what their kernels use
  no-fma             the C library without fused multiply-adds
  qemu:CPU           under qemu-x86_64 as that processor, e.g. qemu:Nehalem (slow: some 20 times)
  arm64              build-arm64/bin under qemu-aarch64 (`tests/run.sh --arm64` builds it); may differ by BOUNDS
Sequences: occlusion (rendered, all of it), plaza (real, 100 frames), sot (real, all of Crossing), from
$GROUNDLOCK_DATA (default ../shared/data); parked (rendered here: a car at rest that the camera walks past, so that
points of its body are followed, triangulated and fitted).
Exits with 0 if all results are the same but for times, with 1 and the first difference else."""
import argparse, csv, math, os, shutil, signal, subprocess, sys, tempfile, time
from pathlib import Path

DATA = Path(os.environ.get("GROUNDLOCK_DATA", "../shared/data"))
ROOT = Path(__file__).resolve().parents[2]
SYSROOT = Path(os.environ.get("GROUNDLOCK_SYSROOT", ROOT / "build-sysroot-arm64"))
# What arm64's results may differ by, in a column's unit, a guess before the first comparison: the camera a centimetre
# and a quarter of a degree (a unit quaternion's part moves by half the angle), boxes by pixels, targets by what such
# boxes make of it.
BOUNDS = {"cam_": 0.01, "cam_q": 0.002, "box_": 1.0, "ground_": 0.05, "heading_": 0.05, "confidence": 0.1,
          "length_": 0.05, "width_": 0.05, "height_": 0.05}
DEFAULT_MODES = ["native", "baseline", "no-fma", "qemu:Nehalem", "qemu:Haswell", "qemu:EPYC"]


def render_parked(binaries, folder):
    """The sequence `parked` and its map: the same files for all modes."""
    for sequence in ("parked65", "mapping"):
        subprocess.run([binaries / "groundlock", "simulate", "yard", sequence, "--size", "480x270", "--samples", "1",
                        "--out", folder], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def first_box(name, rendered):
    """The first box of the sequence's truth as x,y,w,h from 0."""
    if name == "parked":
        return [float(v) for v in (rendered / "parked65_init_box.txt").read_text().split(",")]
    if name == "occlusion":
        with open(DATA / "sim/lot/occlusion_truth.csv") as file:
            row = next(csv.DictReader(file))
        return [float(row["vis_" + side]) for side in "xywh"]
    path = DATA / ("plaza/person12_boxes.txt" if name == "plaza" else "sot/Crossing/groundtruth.txt")
    values = [float(v) for v in path.read_text().splitlines()[0].replace("\t", ",").split(",")[-4:]]
    return [values[0] - 1, values[1] - 1, *values[2:]]


def sequences(rendered):
    return {
        "parked": (rendered / "parked65.mp4", ["--map", "parked", "--camera", rendered / "camera.json"],
                   ["map", "import", "parked", rendered / "map", "--align", rendered / "align.json"], 200),
        "occlusion": (DATA / "sim/lot/occlusion.mp4", ["--map", "occlusion", "--camera", DATA / "sim/lot/camera.json"],
                      ["map", "import", "occlusion", DATA / "sim/lot/map", "--align", DATA / "sim/lot/align.json"], 10000),
        "plaza": (DATA / "plaza/person12.mp4", ["--map", "plaza", "--camera", DATA / "plaza/camera.json"],
                  ["map", "import", "plaza", DATA / "plaza/map"], 100),
        "sot": (DATA / "sot/Crossing/img", ["--no-map", "--camera", None], None, 10000),
    }


def environment(mode):
    env = dict(os.environ)
    if mode in ("baseline", "avx2"):
        env["GROUNDLOCK_INSTRUCTIONS"] = mode
    if mode == "no-fma":
        env["GLIBC_TUNABLES"] = "glibc.cpu.hwcaps=-FMA,-FMA4"
    return env


def command(mode, program, *arguments):
    """How the mode runs one of our programs."""
    if mode == "arm64":
        return ["qemu-aarch64", "-L", SYSROOT, ROOT / "build-arm64/bin" / program.name, *arguments]
    emulator = ["qemu-x86_64", "-cpu", mode[5:]] if mode.startswith("qemu:") else []
    return [*emulator, program, *arguments]


def run(mode, log, program, *arguments):
    """One of our programs, up to its end."""
    done = subprocess.run(command(mode, program, *arguments), env=environment(mode), stdout=log, stderr=log)
    if done.returncode != 0:
        log.seek(0)
        raise SystemExit(f"{mode}: {program} {' '.join(map(str, arguments))}: {log.read()[-4000:]}")


class Server:
    def __init__(self, mode, binaries, folder):
        port_file = folder / "port"
        port_file.unlink(missing_ok=True)
        self.log = open(folder / "server.log", "w")
        self.process = subprocess.Popen(
            command(mode, binaries / "groundlock-server", "--listen", "127.0.0.1:0", "--metrics", "", "--store",
                    folder / "store", "--port-file", port_file),
            env=environment(mode), stdout=self.log, stderr=self.log)
        end = time.time() + 300
        while not (port_file.exists() and port_file.read_text().strip()):
            if self.process.poll() is not None or time.time() > end:
                raise SystemExit(f"{mode}: the server does not start: {(folder / 'server.log').read_text()}")
            time.sleep(0.1)
        self.address = "127.0.0.1:" + port_file.read_text().strip()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(60)


def rows(path):
    """The results without their times."""
    with open(path) as file:
        return [{k: v for k, v in row.items() if not k.endswith("_ms")} for row in csv.DictReader(file)]


def bound(column):
    """By which two architectures' numbers may differ; None: in no way."""
    prefixes = [prefix for prefix in BOUNDS if column.startswith(prefix)]
    return BOUNDS[max(prefixes, key=len)] if prefixes else None


def apart(column, a, b):
    """How far two fields are apart in bounds; above 1 if they must not differ so."""
    if a == b:
        return 0.0
    if bound(column) is None or "" in (a, b):
        return 0.0 if column == "inliers" else float("inf")
    distance = abs(float(a) - float(b))
    if column == "heading_rad":
        distance = min(distance, 2.0 * math.pi - distance)
    return distance / bound(column)


def difference(mode, ours, theirs):
    """The first difference, for arm64 the first beyond bounds; and of arm64 the largest in bounds."""
    if len(ours) != len(theirs):
        return f"{len(ours)} and {len(theirs)} rows", ""
    largest, where = 0.0, ""
    for a, b in zip(ours, theirs):
        for key in a:
            if a[key] == b[key]:
                continue
            what = f"frame {a['frame']}, {key}: {a[key]} and {b[key]}"
            if mode != "arm64" or apart(key, a[key], b[key]) > 1.0:
                return what, ""
            if apart(key, a[key], b[key]) > largest:
                largest, where = apart(key, a[key], b[key]), what
    return None, where


def track(mode, binaries, folder, rendered, name, frames):
    """The sequence's results, by a server and a client of that mode."""
    video, options, imported, most_frames = sequences(rendered)[name]
    if None in options:
        camera = folder / "camera.json"
        camera.write_text('{"width":360,"height":240,"model":"SIMPLE_PINHOLE","params":[400,180,120]}')
        options = ["--no-map", "--camera", camera]
    results = folder / f"{name}.csv"
    box = ",".join(f"{v:g}" for v in first_box(name, rendered))
    with Server(mode, binaries, folder) as server, open(folder / "client.log", "w+") as log:
        cli = binaries / "groundlock"
        if imported:
            run(mode, log, cli, *imported, "--server", server.address)
        run(mode, log, cli, "track", video, *options, "--init-box", box, "--results", results, "--frames",
            f"0:{min(frames, most_frames)}", "--server", server.address)
    return results


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=Path, default=Path("build/bin"))
    parser.add_argument("--frames", type=int, default=10000, help="no more than these of each sequence")
    parser.add_argument("--sequence", action="append", choices=list(sequences(Path())))
    parser.add_argument("--keep", type=Path, help="where the results files go, MODE-SEQUENCE.csv")
    parser.add_argument("modes", nargs="*", metavar="MODE", default=DEFAULT_MODES)
    arguments = parser.parse_args()
    for program in sorted({str(command(mode, ROOT)[0]) for mode in arguments.modes if mode[:5] in ("qemu:", "arm64")}):
        if not shutil.which(program):
            parser.error(f"no {program} (Debian's qemu-user)")
    if not DATA.is_dir():
        print(f"SKIPPED: no data at {DATA}")
        return 0
    if arguments.keep:
        arguments.keep.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as rendered:
        return compare(arguments, Path(rendered))


def compare(arguments, rendered):
    """The exit code."""
    names = arguments.sequence or list(sequences(rendered))
    if "parked" in names:
        render_parked(arguments.bin, rendered)
    failed = False
    reference = {}
    for mode in arguments.modes:
        for name in names:
            with tempfile.TemporaryDirectory() as temporary:
                start = time.time()
                results = track(mode, arguments.bin, Path(temporary), rendered, name, arguments.frames)
                if arguments.keep:
                    shutil.copy(results, arguments.keep / f"{mode.replace(':', '-')}-{name}.csv")
                found = rows(results)
            what, within = difference(mode, reference.setdefault(name, found), found)
            failed |= what is not None
            print(f"{mode:14s} {name:10s} {len(found):4d} rows  {what or ('at most ' + within if within else 'same')}  "
                  f"({time.time() - start:.0f} s)", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
