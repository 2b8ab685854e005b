#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Whether the demo's laps keep their lock, and find it again soon.

usage: demo_lock.py DEMO_FOLDER

Rates results.csv of deploy/demo.sh against the truth of its sequence: both cars are
out of view for a while, one is hidden by the container, and all of it ends where it
began. Says what it found; exits with 1 if it falls short of the bounds below.
"""
import csv
import pathlib
import sys

import score_targets

# No aims: what was measured (docs/benchmarks.md, "The demo's laps") lies inside, also
# with laps of 20 s instead of 16; a fault that was found by chance (a car that came out
# from behind the container and was locked after 91 frames) lies far outside.
CAMERA_TRACKED = 0.99
LOCKED_WHILE_SEEN = 0.85
LOCKED_AGAIN_AFTER = 36  # frames: 1.5 s
TRACKED_WHILE_HIDDEN = 0.05


def locked(frame):
    return frame.tracked and frame.overlap > score_targets.LOCKED


def rate(name, frames, absences_wanted):
    """What is wrong with one car, in words."""
    wrong = []
    seen = [f for f in frames if f.seen > score_targets.SEEN]
    hidden = [f for f in frames if f.seen < score_targets.HIDDEN]
    share = sum(map(locked, seen)) / len(seen)
    false_share = sum(f.tracked for f in hidden) / max(1, len(hidden))
    print(f"{name}: locked in {100 * share:.1f} % of {len(seen)} frames that show it, "
          f"taken for seen in {100 * false_share:.1f} % of {len(hidden)} that do not")
    if share < LOCKED_WHILE_SEEN:
        wrong.append(f"{name}: locked in {share:.3f} of the frames that show it")
    if false_share > TRACKED_WHILE_HIDDEN:
        wrong.append(f"{name}: TRACKED in {false_share:.3f} of the frames that do not show it")
    absences = [(gone, back) for gone, back in score_targets.absences(frames) if back < len(frames)]
    if len(absences) < absences_wanted:
        wrong.append(f"{name}: {len(absences)} absences: the sequence is another one")
    for gone, back in absences:
        after = score_targets.first(frames, back, locked)
        print(f"{name}: not seen for {frames[back].number - frames[gone].number} frames from "
              f"{frames[gone].number}, locked again after {after}")
        if after is None or after > LOCKED_AGAIN_AFTER:
            wrong.append(f"{name}: seen again in frame {frames[back].number}, locked after {after} more")
    if not all(map(locked, seen[-24:])):
        wrong.append(f"{name}: not locked all through its last second")
    return wrong


def main():
    folder = pathlib.Path(sys.argv[1])
    results = folder / "results.csv"
    with open(results, newline="") as file:
        states = {int(row["frame"]): row["camera_state"] for row in csv.DictReader(file)}
    share = sum(state == "TRACKED" for state in states.values()) / len(states)
    print(f"camera: tracked in {100 * share:.1f} % of {len(states)} frames")
    wrong = [] if share >= CAMERA_TRACKED else [f"camera: tracked in {share:.3f} of the frames"]
    for name, truth, absences in (("car", "laps_truth.csv", 2), ("other", "laps_other_truth.csv", 1)):
        frames = score_targets.read_frames(results, folder / "yard" / truth, target=name)
        if len(frames) != len(states):
            wrong.append(f"{name}: followed in {len(frames)} of {len(states)} frames")
            continue
        wrong += rate(name, frames, absences)
    for words in wrong:
        print(f"demo_lock: {words}", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
