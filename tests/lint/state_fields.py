#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Whether all that a session's parts know goes along when it moves: each member of a
class whose fields are listed for saving and restoring (map_store/base/state_stream.h)
must occur in that list, or below, where it says why it need not. A member that is
forgotten makes results differ somewhere, sometime, and no test may come by there.

    tests/lint/state_fields.py
"""
import pathlib
import re
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
LISTS = (
    "server/localization/fast_localizer_state.cc",
    "server/localization/state_fields.h",
    "server/motion/motion_state.cc",
    "server/target/internal/state_fields.h",
    "server/tracking/session_camera.cc",
    "server/tracking/session_targets.cc",
    "server/tracking/state_fields.h",
    "server/tracking/state_values.h",
)
HEADERS = ("map_store/geometry/*.h", "server/**/*.h")

OPTIONS = "follows from the session's options, or the map"
SCRATCH = "of one call or frame, which begins by making it anew"
FOLLOWS = "follows from what is listed"
RESTORED = "restored by name in the same place"
# class: {member: why it is not listed}.
NOT_CARRIED = {
    "ActFilter": {
        "options_": OPTIONS,
        "cells_": OPTIONS,
        "window_": OPTIONS,
        "desired_spectrum_": OPTIONS,
        "names_": SCRATCH,
        "intensity_": SCRATCH,
        "patch_features_": SCRATCH,
        "product_": SCRATCH,
        "correlation_": SCRATCH,
        "kernel_spectrum_": SCRATCH,
        "response_": SCRATCH,
    },
    "ActTracker": {"options_": OPTIONS, "sampler_": SCRATCH},
    "ColourHistogram": {
        "side_": OPTIONS,
        "grid_": OPTIONS,
        "bins_": SCRATCH,
        "target_now_": SCRATCH,
        "around_now_": SCRATCH,
        "integral_": SCRATCH,
        "evidence_": SCRATCH,
        "evidence_integral_": SCRATCH,
    },
    "DcfFilter": {
        "options_": OPTIONS,
        "transform_": OPTIONS,
        "crop_first_": SCRATCH,
        "crop_end_": SCRATCH,
        "desired_": FOLLOWS,
        "patch_": SCRATCH,
        "packed_": SCRATCH,
        "before_": SCRATCH,
        "multiplier_": SCRATCH,
        "row_turns_": SCRATCH,
        "cosines_": SCRATCH,
        "sines_": SCRATCH,
        "plane_": SCRATCH,
        "response_column_": SCRATCH,
        "response_spectrum_": SCRATCH,
        "response_": SCRATCH,
    },
    "DcfTracker": {
        "options_": OPTIONS,
        "features_": OPTIONS,
        "merged_": SCRATCH,
        "left_out_px_": SCRATCH,
        "expectation_": SCRATCH,
        "recalled_": SCRATCH,
    },
    "PatchSampler": {
        "cells_": OPTIONS,
        "horizontal_": SCRATCH,
        "vertical_": SCRATCH,
        "offsets_": SCRATCH,
        "columns_": SCRATCH,
        "means_": SCRATCH,
        "halves_": SCRATCH,
    },
    "ScaleFilter": {
        "steps_": OPTIONS,
        "places_": OPTIONS,
        "transform_": OPTIONS,
        "desired_": OPTIONS,
        "sampler_": SCRATCH,
        "histogram_": SCRATCH,
        "features_": SCRATCH,
        "patch_columns_": SCRATCH,
        "model_": SCRATCH,
        "samples_": SCRATCH,
        "spectrum_": SCRATCH,
    },
    "GroundTarget": {"surface_": OPTIONS, "axes_": OPTIONS},
    "MotionSaliency": {"now_": SCRATCH},
    "StandingLandmarks": {
        "map_": OPTIONS,
        "ground_": OPTIONS,
        "min_landmark_views_": OPTIONS,
    },
    "TargetSilhouette": {"seen_": SCRATCH, "beside_": SCRATCH},
    "TargetTrack": {
        "id_": RESTORED,
        "options_": OPTIONS,
        "recalled_": RESTORED,
        "hypothesis_": RESTORED,
    },
    "CameraStateMachine": {"lost_after_": OPTIONS, "hold_": OPTIONS},
    "Gyroscope": {"imu_": OPTIONS},
    "PosePrior": {"geodetic_position": "placed in the map's world before"},
    "PoseFilter": {"options_": OPTIONS},
    "SessionLandmarks::Landmark": {"p_world": FOLLOWS},
}
# What is listed with what is around it.
WITHIN = {
    "InteractingModels::Model": "InteractingModels",
    "ViewMemory::Sector": "ViewMemory",
}


def without_comments(text):
    return re.sub(r"//[^\n]*", "", text)


def braces_end(text, at):
    """After the brace that closes the one at `at`."""
    depth = 0
    for i in range(at, len(text)):
        depth += {"{": 1, "}": -1}.get(text[i], 0)
        if depth == 0:
            return i + 1
    raise ValueError("braces do not match")


def lists():
    """What is written of each class, by its name as the lists have it."""
    found = {}
    head = re.compile(r"StateOf<(?:T,\s*)?([\w:]+)>[^{;]*?\bvoid\s+(?:StateValue|Of)\(")
    for path in LISTS:
        text = without_comments((ROOT / path).read_text(encoding="utf-8"))
        for match in head.finditer(text):
            begin = text.index("{", match.end())
            body = text[begin : braces_end(text, begin)]
            name = match[1].split("::")
            # Foo::Bar, or a name with its namespace before it.
            key = "::".join(part for part in name if part[0].isupper())
            if key:
                found[key] = found.get(key, "") + body
    return found


def members(body):
    """(names of the members, classes within) of the text between its braces."""
    names, nested, statement, i = [], [], "", 0
    while i < len(body):
        char = body[i]
        if char == "{":
            end = braces_end(body, i)
            kind = re.match(r"\s*(?:struct|class)\s+(\w+)", statement)
            is_function = "(" in re.sub(r"<[^<>]*>", "", statement)
            if kind:
                nested.append((kind[1], body[i + 1 : end - 1]))
            if kind or is_function or statement.strip().startswith(("enum", "union")):
                statement = "" if is_function else "struct "
            i = end
            continue
        if char == ";":
            names += declared(statement)
            statement = ""
        elif char == ":" and re.match(r"\s*(public|private|protected)$", statement):
            statement = ""
        else:
            statement += char
        i += 1
    return names, nested


def declared(statement):
    statement = statement.strip()
    if re.match(r"(using|friend|static|enum|template|typedef|struct|class|requires)\b", statement):
        return []
    while re.search(r"<[^<>]*>", statement):
        statement = re.sub(r"<[^<>]*>", "", statement)
    statement = re.sub(r"=[^,]*\([^()]*\)", "", statement)  # = Eigen::...::Zero()
    statement = re.sub(r"=[^,]*", "", statement)
    if "(" in statement:
        return []
    parts = [re.findall(r"\w+", part) for part in statement.split(",")]
    return [words[-1] for words in parts if words] if len(parts[0]) > 1 else []


def classes():
    """(name with those around it, text between its braces) of all headers."""

    def within(outer, name, body):
        full = f"{outer}::{name}" if outer else name
        yield full, body
        for inner, text in members(body)[1]:
            yield from within(full, inner, text)

    for pattern in HEADERS:
        for path in sorted(ROOT.glob(pattern)):
            text = without_comments(path.read_text(encoding="utf-8"))
            for match in re.finditer(r"^(?:struct|class) (\w+)[^;{}()]*\{", text, re.M):
                end = braces_end(text, match.end() - 1)
                for full, body in within("", match[1], text[match.end() : end - 1]):
                    yield path.relative_to(ROOT), full, body


def main():
    listed = lists()
    failures, seen, checked = [], set(), 0
    for path, name, body in classes():
        if name in WITHIN:
            listed[name] = listed[WITHIN[name]]
        if name not in listed:
            continue
        seen.add(name)
        excused = NOT_CARRIED.get(name, {})
        names = members(body)[0]
        for member in names:
            checked += 1
            is_listed = re.search(rf"(?:\.|->){member}\b", listed[name])
            if not is_listed and member not in excused:
                failures.append(f"{path}: {name}::{member} is not carried")
        for member in excused:
            if member not in names:
                failures.append(f"{path}: {name} has no {member} to excuse")
    # Whereabouts is one of several classes, which the compiler asks for.
    failures += [f"no header has {name}" for name in {*listed} - seen - {"Whereabouts"}]
    failures += [f"no list of {name}" for name in NOT_CARRIED if name not in listed]
    for failure in failures:
        print(f"state fields: {failure}", file=sys.stderr)
    if failures:
        sys.exit(1)
    print(f"state fields: {checked} members of {len(seen)} classes are carried, or need not be")


if __name__ == "__main__":
    main()
