#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Scores the movers of a rendered sequence (groundlock track --movers, or
track_with_truth --movers) against its truth.

    tests/eval/score_movers.py MOVERS.csv TRUTH.csv [OTHER_TRUTH.csv]

A thing of the truth is due in a frame if it goes at 0.2 m/s or more there and at
least 30 % of it are seen, once movers are looked for. A mover is right if its box's
centre lies in the box of such a thing, enlarged by a quarter on each side; further
ones in the same box are counted as twice; one in the box of a thing that stands, or
is not due yet, counts for nothing; all others are false."""
import csv
import json
import math
import sys

MIN_SPEED_M_S = 0.2
MIN_SEEN = 0.3


def number(text):
    return float(text) if text else None


def read_truth(path):
    with open(path, encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    things = {}
    for i, row in enumerate(rows):
        before, after = rows[max(0, i - 3)], rows[min(len(rows) - 1, i + 3)]
        step = float(after["t_s"]) - float(before["t_s"])
        velocity = [(float(after[k]) - float(before[k])) / step for k in ("tgt_x", "tgt_y")]
        box = [number(row[f"vis_{k}"]) for k in "xywh"]
        things[int(row["frame"])] = {
            "box": None if None in box else box,
            "place": [float(row["tgt_x"]), float(row["tgt_y"])],
            "velocity": velocity,
            "distance": math.dist(
                [float(row[f"cam_{k}"]) for k in "xyz"], [float(row[f"tgt_{k}"]) for k in "xyz"]
            ),
            "due": math.hypot(*velocity) >= MIN_SPEED_M_S and float(row["seen_fraction"]) >= MIN_SEEN,
        }
    return things


def read_movers(path):
    frames = {}
    with open(path, encoding="utf-8") as file:
        for row in csv.DictReader(file):
            movers = frames.setdefault(int(row["frame"]), (row["movers_state"], []))[1]
            if row["mover"]:
                movers.append(
                    {
                        "id": row["mover"],
                        "box": [float(row[f"box_{k}"]) for k in "xywh"],
                        "place": [float(row["ground_x"]), float(row["ground_y"])],
                        "velocity": [float(row["velocity_x"]), float(row["velocity_y"])],
                    }
                )
    return frames


def is_at(mover, box):
    x, y, w, h = box
    cx = mover["box"][0] + mover["box"][2] / 2
    cy = mover["box"][1] + mover["box"][3] / 2
    return x - w / 4 <= cx <= x + 1.25 * w and y - h / 4 <= cy <= y + 1.25 * h


def iou(a, b):
    w = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0])
    h = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    common = max(0.0, w) * max(0.0, h)
    return common / (a[2] * a[3] + b[2] * b[3] - common)


def median(values):
    values = sorted(values)
    return values[len(values) // 2] if values else None


def score(movers_path, truth_paths):
    truths = [read_truth(path) for path in truth_paths]
    frames = read_movers(movers_path)
    due = right = twice = false = watched = 0
    runs, delays, ids, false_ids = [None] * len(truths), [], set(), set()
    places, speeds, overlaps, shares = [], [], [], []
    false_frames = []
    for frame in sorted(frames):
        state, movers = frames[frame]
        watched += state == "WATCHING"
        free = list(movers)
        for index, truth in enumerate(truths):
            thing = truth.get(frame)
            if thing is None or thing["box"] is None:
                runs[index] = None
                continue
            near = [m for m in free if is_at(m, thing["box"])]
            free = [m for m in free if m not in near]
            if not thing["due"]:
                runs[index] = None
                continue
            due += 1
            if runs[index] is None:
                runs[index] = [frame, False]
            if not near:
                continue
            best = min(near, key=lambda m: math.dist(m["place"], thing["place"]))
            right += 1
            twice += len(near) - 1
            ids.add((index, best["id"]))
            if not runs[index][1]:
                runs[index][1] = True
                delays.append(frame - runs[index][0])
            places.append(math.dist(best["place"], thing["place"]))
            shares.append(places[-1] / thing["distance"])
            speeds.append(math.dist(best["velocity"], thing["velocity"]) / math.hypot(*thing["velocity"]))
            overlaps.append(iou(best["box"], thing["box"]))
        false += len(free)
        false_ids.update(m["id"] for m in free)
        if free:
            false_frames.append(frame)
    return {
        "frames": len(frames),
        "watching": watched,
        "due": due,
        "right": right,
        "recall": round(right / due, 3) if due else None,
        "precision": round(right / (right + false), 3) if right + false else None,
        "false_per_frame": round(false / max(1, watched), 3),
        "false_movers": len(false_ids),
        "twice": twice,
        "ids": len(ids),
        "delay_frames": delays,
        "place_error_m": median(places) and round(median(places), 3),
        "place_error_of_distance": median(shares) and round(median(shares), 3),
        "velocity_error": median(speeds) and round(median(speeds), 3),
        "iou": median(overlaps) and round(median(overlaps), 3),
        "false_frames": false_frames[:12],
    }


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    print(json.dumps(score(sys.argv[1], sys.argv[2:])))
