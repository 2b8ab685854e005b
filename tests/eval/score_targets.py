#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Scores how a target was followed through a rendered sequence.

usage: score_targets.py RESULTS_CSV TRUTH_CSV [THRESHOLD [TARGET]]

Prints the mean overlap of the box with the visible part while more than half
of it is seen, whether the target was locked in the last second, and for every
time it was out of sight (less than 2 % seen): the frames from its vanishing to
the confidence falling below THRESHOLD (0.5), and from half of it being seen
again to the confidence being above, and to TRACKED with an overlap of 0.3.
"""
import csv
import sys

SEEN = 0.5
HIDDEN = 0.02
LOCKED = 0.3


def numbers(row, names):
    try:
        return [float(row[name]) for name in names]
    except (ValueError, KeyError):
        return None


def overlap(a, b):
    width = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0])
    height = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    both = max(0.0, width) * max(0.0, height)
    return both / (a[2] * a[3] + b[2] * b[3] - both)


class Frame:
    def __init__(self, result, truth, threshold):
        self.number = int(truth["frame"])
        self.seen = float(truth["seen_fraction"] or 0)
        box = numbers(result, ["box_x", "box_y", "box_w", "box_h"])
        visible = numbers(truth, ["vis_x", "vis_y", "vis_w", "vis_h"])
        self.overlap = overlap(box, visible) if box and visible else 0.0
        self.confidence = float(result["confidence"] or 0)
        self.sure = self.confidence >= threshold
        self.tracked = result["target_state"] == "TRACKED"


def first(frames, start, test):
    """Frames from `start` to the first that passes; None if none does."""
    for i in range(start, len(frames)):
        if test(frames[i]):
            return i - start
    return None


def absences(frames):
    """(first hidden, first half seen again) as indices."""
    i = 0
    while i < len(frames):
        if frames[i].seen >= HIDDEN:
            i += 1
            continue
        gone = i
        while i < len(frames) and frames[i].seen <= SEEN:
            i += 1
        yield gone, i


def read_frames(results_csv, truth_csv, threshold=0.5, target=None):
    """A Frame for each in which the target has a result."""
    with open(results_csv, newline="") as file:
        results = {int(row["frame"]): row for row in csv.DictReader(file)
                   if target in (None, row["target"])}
    with open(truth_csv, newline="") as file:
        return [Frame(results[int(row["frame"])], row, threshold)
                for row in csv.DictReader(file)
                if int(row["frame"]) in results
                and results[int(row["frame"])]["target_state"]]


def main():
    threshold = float(sys.argv[3]) if len(sys.argv) > 3 else 0.5
    target = sys.argv[4] if len(sys.argv) > 4 else None
    frames = read_frames(sys.argv[1], sys.argv[2], threshold, target)
    seen = [frame for frame in frames if frame.seen > SEEN]
    hidden = [frame for frame in frames if frame.seen < HIDDEN]
    share = lambda part, of: sum(part) / len(of) if of else float("nan")
    print(f"frames {len(frames)}, seen {len(seen)}, hidden {len(hidden)}")
    print(f"overlap while seen       {share([f.overlap for f in seen], seen):.3f}")
    print(f"tracked while seen       {share([f.tracked for f in seen], seen):.3f}")
    print(f"sure while hidden        {share([f.sure for f in hidden], hidden):.3f}")
    last = seen[-24:]
    print(f"locked at the end        {share([f.overlap > LOCKED for f in last], last):.3f}")
    for gone, back in absences(frames):
        falls = first(frames, gone, lambda f: not f.sure)
        line = f"hidden from {frames[gone].number}: unsure after {falls}"
        if back < len(frames):
            rises = first(frames, back, lambda f: f.sure)
            locks = first(frames, back,
                          lambda f: f.tracked and f.overlap > LOCKED)
            line += (f"; seen from {frames[back].number}: sure after {rises}, "
                     f"locked after {locks}")
        print(line)


if __name__ == "__main__":
    main()
