#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Prints the frame in the middle of the last run of at least eight frames in
which the target was predicted, not seen; the middle frame of all if there is
none.

usage: hidden_frame.py RESULTS_CSV [TARGET]
"""
import csv
import sys


def main():
    with open(sys.argv[1], newline="") as file:
        rows = [row for row in csv.DictReader(file)
                if len(sys.argv) < 3 or row["target"] == sys.argv[2]]
    if not rows:
        sys.exit(f"{sys.argv[1]}: no rows")
    runs, run = [], []
    for row in rows:
        if row["target_state"] == "PREDICTED":
            run.append(int(row["frame"]))
        else:
            runs.append(run)
            run = []
    long_ones = [run for run in runs + [run] if len(run) >= 8]
    middle = long_ones[-1] if long_ones else [int(row["frame"]) for row in rows]
    print(middle[len(middle) // 2])


main()
