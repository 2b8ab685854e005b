#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Fits the confidence of the default tracker to the samples that
confidence_samples writes, and measures how honest it is.

usage: fit_confidence.py SAMPLES_CSV [RELIABILITY_SVG]

Confidence = 1 / (1 + exp(-(slope * log(sharpness) + offset))), by maximum
likelihood of the box overlapping the target by half. Fitted on the sequences
(rows not from a video file), each left out once; videos are held out
altogether. Prints the fit, the expected calibration error in ten bins, and the
share of samples that overlap per bin, and draws the latter.
"""
import csv
import math
import sys

BINS = 10


def read(path):
    samples = []
    with open(path, newline="") as file:
        for row in csv.DictReader(file):
            sharpness = float(row["sharpness"])
            hit = float(row["overlap"]) >= 0.5
            samples.append((row["sequence"], sharpness, hit))
    return samples


def logistic(x):
    return 1.0 / (1.0 + math.exp(-min(max(x, -30.0), 30.0)))


def probability(fit, sharpness):
    if sharpness <= 0.0:
        return 0.0
    return logistic(fit[0] * math.log(sharpness) + fit[1])


def fit(samples):
    """Newton's method on the log-likelihood."""
    slope, offset = 0.0, 0.0
    points = [(math.log(s), hit) for _, s, hit in samples if s > 0.0]
    for _ in range(50):
        g0 = g1 = h00 = h01 = h11 = 0.0
        for x, hit in points:
            p = logistic(slope * x + offset)
            w = p * (1.0 - p)
            g0 += (hit - p) * x
            g1 += hit - p
            h00 += w * x * x
            h01 += w * x
            h11 += w
        determinant = h00 * h11 - h01 * h01
        slope += (h11 * g0 - h01 * g1) / determinant
        offset += (h00 * g1 - h01 * g0) / determinant
    return slope, offset


def bins(pairs):
    """Per bin: mean confidence, share of hits, count."""
    table = []
    for k in range(BINS):
        inside = [(p, hit) for p, hit in pairs
                  if min(int(p * BINS), BINS - 1) == k]
        if inside:
            table.append((sum(p for p, _ in inside) / len(inside),
                          sum(hit for _, hit in inside) / len(inside),
                          len(inside)))
    return table


def calibration_error(pairs):
    return sum(abs(p - share) * count
               for p, share, count in bins(pairs)) / len(pairs)


def draw(path, curves):
    width, height, left, top, side = 520, 420, 60, 30, 340
    colours = ["#d55e00", "#0072b2"]
    place = lambda x, y: (left + side * x, top + side * (1.0 - y))
    out = [f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {width} "
           f"{height}' width='{width}' height='{height}' "
           "font-family='sans-serif' font-size='12'>",
           "<rect width='100%' height='100%' fill='#ffffff'/>"]
    for i in range(6):
        (x0, y0), (x1, y1) = place(i / 5, 0), place(i / 5, 1)
        out.append(f"<line x1='{x0:.1f}' y1='{y0:.1f}' x2='{x1:.1f}' "
                   f"y2='{y1:.1f}' stroke='#dddddd'/>")
        out.append(f"<text x='{x0:.1f}' y='{y0 + 16:.1f}' "
                   f"text-anchor='middle'>{i / 5:g}</text>")
        (x0, y0), (x1, y1) = place(0, i / 5), place(1, i / 5)
        out.append(f"<line x1='{x0:.1f}' y1='{y0:.1f}' x2='{x1:.1f}' "
                   f"y2='{y1:.1f}' stroke='#dddddd'/>")
        out.append(f"<text x='{x0 - 6:.1f}' y='{y0 + 4:.1f}' "
                   f"text-anchor='end'>{i / 5:g}</text>")
    (x0, y0), (x1, y1) = place(0, 0), place(1, 1)
    out.append(f"<line x1='{x0}' y1='{y0}' x2='{x1}' y2='{y1}' "
               "stroke='#555555' stroke-dasharray='4 4'/>")
    for (label, table), colour in zip(curves, colours):
        points = [place(p, share) for p, share, _ in table]
        out.append("<polyline points='"
                   + " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
                   + f"' fill='none' stroke='{colour}' stroke-width='2'/>")
        out += [f"<circle cx='{x:.1f}' cy='{y:.1f}' r='3' fill='{colour}'/>"
                for x, y in points]
        row = top + 20 + 18 * colours.index(colour)
        out.append(f"<text x='{left + 14}' y='{row}' fill='{colour}'>"
                   f"{label}</text>")
    out.append(f"<text x='{left + side / 2}' y='{top + side + 36}' "
               "text-anchor='middle'>confidence</text>")
    out.append(f"<text x='16' y='{top + side / 2}' text-anchor='middle' "
               f"transform='rotate(-90 16 {top + side / 2})'>"
               "share of boxes that overlap by half</text>")
    out.append("</svg>")
    with open(path, "w") as file:
        file.write("\n".join(out) + "\n")


def main():
    samples = read(sys.argv[1])
    fitted = [s for s in samples if not s[0].endswith(".mp4")]
    held_out = [s for s in samples if s[0].endswith(".mp4")]
    left_out = []
    for name in sorted({s[0] for s in fitted}):
        rest = fit([s for s in fitted if s[0] != name])
        left_out += [(probability(rest, s[1]), s[2])
                     for s in fitted if s[0] == name]
    whole = fit(fitted)
    print(f"slope {whole[0]:.2f}, offset {whole[1]:.2f}")
    curves = [("sequences, each left out", left_out)]
    if held_out:
        curves.append(("rendered drives",
                       [(probability(whole, s[1]), s[2]) for s in held_out]))
    for label, pairs in curves:
        print(f"{label}: {len(pairs)} samples, expected calibration error "
              f"{calibration_error(pairs):.3f}")
        for p, share, count in bins(pairs):
            print(f"  confidence {p:.2f}: {share:.2f} of {count}")
    if len(sys.argv) > 2:
        draw(sys.argv[2], [(label, bins(pairs)) for label, pairs in curves])


main()
