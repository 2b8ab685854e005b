#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Whether the clients speak all of the protocol: each field of its messages must
occur where the C++, the Python and the TypeScript client translate them, and each
call where they make it. A field that a client passes over is a thing that its users
cannot have, and nobody would miss it.

    tests/lint/sdk_fields.py
"""
import pathlib
import re
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
# (client, message.field): what a client does without, and why.
WITHOUT = {
    # How many blocks will bring: a client that gathers them all counts for itself.
    ("C++", "GetPointCloudResponse.total_points"),
    ("Python", "GetPointCloudResponse.total_points"),
    ("TypeScript", "GetPointCloudResponse.total_points"),
}


def camel(name):
    return re.sub(r"_(\w)", lambda m: m[1].upper(), name)


def sources(*patterns):
    return "\n".join(
        path.read_text(encoding="utf-8")
        for pattern in patterns
        for path in sorted(ROOT.glob(pattern))
        if "gen" not in path.parts and "v1" not in path.parts
    )


CLIENTS = {
    "C++": (
        sources("client/sdk/*.cc"),
        lambda field: rf"\b(?:set_|mutable_|add_|has_)?{field}\(",
        lambda call: rf"\b{call}\b",
    ),
    "Python": (
        sources("client/python/groundlock/*.py"),
        lambda field: rf"\b{field}\b",
        lambda call: rf"\"{call}\"",
    ),
    "TypeScript": (
        sources("client/typescript/src/*.ts"),
        lambda field: rf"\b{camel(field)}\b",
        lambda call: rf"\.{call[0].lower() + call[1:]}\b",
    ),
}


def protocol():
    """(message, field) and the names of the calls, as the files have them."""
    fields, calls = [], []
    for path in sorted((ROOT / "proto/groundlock/v1").glob("*.proto")):
        messages = []  # the names of what is open, "" for what is no message
        for line in path.read_text(encoding="utf-8").splitlines():
            line = line.split("//")[0]
            calls += re.findall(r"\brpc (\w+)", line)
            field = re.match(r"\s*(?:repeated |optional )?[\w.]+(?:<.*>)? (\w+) = \d+\b", line)
            if field and any(messages) and messages[-1] != "enum":
                fields.append((next(m for m in reversed(messages) if m), field[1]))
            opened = re.match(r"\s*(message|enum|oneof|service|rpc) (\w+)", line)
            for brace in re.findall(r"[{}]", line):
                if brace == "}":
                    messages.pop()
                else:
                    kind, name = opened.groups() if opened else ("", "")
                    messages.append(name if kind == "message" else "enum" if kind == "enum" else "")
    return fields, calls


def main():
    fields, calls = protocol()
    if len(fields) < 100 or len(calls) < 15:
        sys.exit(f"sdk_fields: only {len(fields)} fields and {len(calls)} calls were read")
    missing = []
    for client, (text, of_field, of_call) in CLIENTS.items():
        missing += [
            f"{client}: {message}.{field}"
            for message, field in fields
            if (client, f"{message}.{field}") not in WITHOUT and not re.search(of_field(field), text)
        ]
        missing += [f"{client}: {call}()" for call in calls if not re.search(of_call(call), text)]
    for one in missing:
        print(f"sdk_fields: not in {one}", file=sys.stderr)
    if missing:
        return 1
    print(f"sdk_fields: {len(fields)} fields and {len(calls)} calls are known to {', '.join(CLIENTS)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
