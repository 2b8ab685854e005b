# SPDX-License-Identifier: Apache-2.0
"""Makes a table of a recording of the dashboard; needs no server.

    recording_to_csv.py RECORDING.mcap OUT.csv [--images FOLDER]
"""
from __future__ import annotations

import argparse
import sys
from pathlib import Path

import groundlock


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording")
    parser.add_argument("csv")
    parser.add_argument("--images", help="also write the frames' images there")
    args = parser.parse_args()
    try:
        with groundlock.Recording(args.recording) as recording:
            if not recording.complete:
                print("the recording was interrupted; read up to its last chunk", file=sys.stderr)
            rows = groundlock.write_csv(args.csv, recording.results())
            print(f"session {recording.session.session_id}: {rows} rows")
            if args.images:
                folder = Path(args.images)
                folder.mkdir(parents=True, exist_ok=True)
                for image in recording.images():
                    ending = "png" if image.image.encoding is groundlock.Encoding.PNG else "jpg"
                    (folder / f"{image.capture_time_ns}.{ending}").write_bytes(image.image.data)
    except groundlock.GroundlockError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
