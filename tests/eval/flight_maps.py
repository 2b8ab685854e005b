#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Maps from videos as a new user makes them: builds, tracks, and judges.

usage: flight_maps.py VIDEO... [--bin build/bin] [--work DIR] [--variants half,small,...]
                      [--horizons horizons.csv]

For each video: `map build NAME --video VIDEO` (no lens, defaults), then `track VIDEO
--map NAME` without a target, both with a server of the program's own. Prints a row of
a Markdown table for each, and what falls short. --variants makes further videos of each
with FFmpeg: reversed (rev), every other frame (half), the middle two thirds (crop), and
640 pixels wide (small). What is in the work folder already is not done again.

--horizons: lines of VIDEO_STEM,FRAME,ROW,SIGMA: where the horizon is seen in a picture
without roll, in pixels. A ground that is known must agree within 2 degrees and SIGMA.

Falls short: fewer than 95 % of the frames TRACKED, 0.7 px or more of reprojection error,
more CPU than four times the video's length at 10 frames/s on two cores, a focal length
(--focal, with the factor that a variant brings) that is off by more than 5 % and three
of its sigmas, a ground that the horizon refutes. The exit status is 1 then.
"""
import argparse
import csv
import json
import math
import os
import pathlib
import resource
import subprocess
import sys

TRACKED = 0.95
MAX_ERROR_PX = 0.7
CPU_S_PER_FRAME = 4.0 * 2.0 / 10.0
MAX_FOCAL_OFF = 0.05
MAX_PITCH_OFF_DEG = 2.0
# FFmpeg's filter, and what becomes of the focal length.
VARIANTS = {
    "rev": ("reverse", lambda width: 1.0),
    "half": ("select=not(mod(n\\,2)),setpts=N/5/TB", lambda width: 1.0),
    "crop": ("crop=trunc(iw/3)*2:trunc(ih/3)*2", lambda width: 1.0),
    "small": ("scale=640:-2", lambda width: 640.0 / width),
}


def cpu_s():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def run(command, log):
    """Output and CPU seconds; None for the output if the command failed."""
    before = cpu_s()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    log.write_text(done.stdout + done.stderr, errors="replace")
    if done.returncode != 0:
        print(f"{log.stem}: {done.stderr.strip().splitlines()[-1:]}", file=sys.stderr)
        return None, cpu_s() - before
    return done.stdout, cpu_s() - before


def size_of(video):
    out = subprocess.run(
        ["ffprobe", "-v", "error", "-select_streams", "v", "-show_entries",
         "stream=width,height", "-of", "csv=p=0", str(video)],
        capture_output=True, text=True, check=True).stdout
    width, height = out.strip().split(",")[:2]
    return int(width), int(height)


def make_variant(video, kind, work):
    out = work / f"{video.stem}_{kind}.mp4"
    if not out.exists():
        subprocess.run(
            ["ffmpeg", "-nostdin", "-loglevel", "error", "-y", "-i", str(video), "-vf",
             VARIANTS[kind][0], "-c:v", "libx264", "-crf", "12", "-preset", "veryfast",
             "-pix_fmt", "yuv420p", "-an", str(out)], check=True)
    return out


def build(name, video, program, work):
    """The build's answer with `cpu_s`, or None."""
    kept = work / f"{name}.json"
    if not kept.exists():
        out, cpu = run([program, "map", "build", name, "--video", str(video), "--work",
                        str(work / f"{name}.build"), "--local", "--json"],
                       work / f"{name}.build.log")
        if out is None:
            return None
        answer = json.loads(out)
        answer["cpu_s"] = cpu
        kept.write_text(json.dumps(answer))
    return json.loads(kept.read_text())


def track(name, video, program, work):
    """Camera states and rotations by frame: the first row of each."""
    results = work / f"{name}.csv"
    if not results.exists():
        run([program, "track", str(video), "--map", name, "--local", "--results",
             str(results)], work / f"{name}.track.log")
    frames = {}
    if results.exists():
        with results.open() as rows:
            for row in csv.DictReader(rows):
                frames.setdefault(int(row["frame"]), row)
    return frames


def horizon_row(row, normal, focal_px, height_px):
    """Where the plane's horizon crosses the picture's middle; None without a pose."""
    if not row["cam_qw"]:
        return None
    w, x, y, z = (float(row["cam_q" + axis]) for axis in "wxyz")
    rotation = [[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]
    up = [sum(rotation[r][c] * normal[r] for r in range(3)) for c in range(3)]
    if abs(up[1]) < 1e-9:
        return None
    return 0.5 * height_px - focal_px * up[2] / up[1]


def worst_pitch_deg(frames, wanted, normal, focal_px, height_px):
    """Beyond what the horizon seen is itself uncertain by; None if nothing compares."""
    worst = None
    for frame, row_px, sigma_px in wanted:
        if frame not in frames:
            continue
        found = horizon_row(frames[frame], normal, focal_px, height_px)
        if found is None:
            continue
        middle = 0.5 * height_px
        off = abs(math.degrees(math.atan((found - middle) / focal_px) -
                               math.atan((row_px - middle) / focal_px)))
        off = max(0.0, off - math.degrees(sigma_px / focal_px))
        worst = off if worst is None else max(worst, off)
    return worst


def judge(name, answer, frames, focal_px, horizons):
    """A table's row, and what falls short."""
    report = answer["report"]
    num_frames = max(frames) + 1 if frames else 0
    tracked = sum(row["camera_state"] == "TRACKED" for row in frames.values())
    share = tracked / max(1, num_frames)
    camera = report["cameras"][0]
    found_px = camera["params"][0]
    sigma_px = report["focal_sigma_px"] or 0.0
    error_px = report["mean_reprojection_error_px"]
    ground = answer["map"]["ground"]
    known = ground["state"] != "unknown"
    short = []
    if share < TRACKED:
        short.append(f"{100 * share:.0f} % of the frames tracked")
    if error_px >= MAX_ERROR_PX:
        short.append(f"error {error_px:.2f} px")
    if answer["cpu_s"] > CPU_S_PER_FRAME * num_frames:
        short.append("CPU")
    if focal_px and abs(found_px - focal_px) > max(MAX_FOCAL_OFF * focal_px,
                                                   3.0 * sigma_px):
        short.append(f"focal length {found_px:.0f}, not {focal_px:.0f}")
    pitch = worst_pitch_deg(frames, horizons, ground["normal"], found_px, camera["height"])
    if known and pitch is not None and pitch > MAX_PITCH_OFF_DEG:
        short.append(f"the horizon refutes the ground by {pitch:.1f} deg")
    ground_text = f"± {ground['sigma_deg']:.1f}°" if known else "unknown"
    pitch_text = "" if pitch is None else f"{pitch:.1f}°"
    row = (f"| `{name}` | {num_frames} | {answer['cpu_s']:.0f} s "
           f"({CPU_S_PER_FRAME * num_frames:.0f}) | {report['num_registered']} of "
           f"{report['num_images']} | {report['num_landmarks']:,} | {error_px:.2f} px | "
           f"{found_px:.0f} ± {sigma_px:.0f} | {100 * share:.1f} % | {ground_text} | "
           f"{pitch_text} |")
    return row, short


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("videos", nargs="+", type=pathlib.Path)
    parser.add_argument("--bin", default="build/bin")
    parser.add_argument("--work", default="flight_maps", type=pathlib.Path)
    parser.add_argument("--variants", default="", help="of rev, half, crop, small")
    parser.add_argument("--only-variants", action="store_true")
    parser.add_argument("--horizons", type=pathlib.Path)
    parser.add_argument("--focal", action="append", default=[],
                        help="STEM=PX: the true focal length of a video")
    options = parser.parse_args()
    program = str(pathlib.Path(options.bin).resolve() / "groundlock")
    work = options.work.resolve()
    work.mkdir(parents=True, exist_ok=True)
    # The program's own server keeps its maps here.
    os.environ["XDG_DATA_HOME"] = str(work / "maps")
    focal = dict(pair.split("=") for pair in options.focal)
    horizons = {}
    if options.horizons:
        with options.horizons.open() as rows:
            for stem, frame, row_px, sigma_px in csv.reader(rows):
                horizons.setdefault(stem, []).append(
                    (int(frame), float(row_px), float(sigma_px)))
    print("| video | frames | CPU (allowed) | keyframes in the map | landmarks | error | "
          "focal length, px | TRACKED | ground | pitch off |\n|" + "---|" * 10)
    failures = []
    for video in options.videos:
        true_px = float(focal[video.stem]) if video.stem in focal else None
        width, _ = size_of(video)
        runs = [] if options.only_variants else [
            (video, true_px, horizons.get(video.stem, []))]
        for kind in filter(None, options.variants.split(",")):
            scaled = true_px * VARIANTS[kind][1](width) if true_px else None
            runs.append((make_variant(video, kind, work), scaled, []))
        for clip, clip_px, clip_horizons in runs:
            name = clip.stem
            answer = build(name, clip, program, work)
            if answer is None:
                failures.append(f"{name}: no map")
                print(f"| `{name}` | | | none | | | | | | |", flush=True)
                continue
            frames = track(name, clip, program, work)
            row, short = judge(name, answer, frames, clip_px, clip_horizons)
            print(row, flush=True)
            failures += [f"{name}: {what}" for what in short]
    for failure in failures:
        print(f"falls short: {failure}")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
