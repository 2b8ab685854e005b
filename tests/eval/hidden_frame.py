#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Prints the frame in the middle of the longest run of frames in which the
target was predicted, not seen; the middle frame of all if there is none.

usage: hidden_frame.py RESULTS_CSV
"""
import csv
import sys


def main():
    with open(sys.argv[1], newline="") as file:
        rows = list(csv.DictReader(file))
    if not rows:
        sys.exit(f"{sys.argv[1]}: no rows")
    runs, run = [], []
    for row in rows:
        if row["target_state"] == "PREDICTED":
            run.append(int(row["frame"]))
        else:
            runs.append(run)
            run = []
    longest = max(runs + [run], key=len)
    middle = longest or [int(row["frame"]) for row in rows]
    print(middle[len(middle) // 2])


main()
