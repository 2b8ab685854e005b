# SPDX-License-Identifier: Apache-2.0
"""Follows a target through a video or a camera, frame by frame, with OpenCV.

    opencv_loop.py INPUT CAMERA_JSON MAP X,Y,W,H [--show] [--save OUT.mp4]
"""
from __future__ import annotations

import argparse
from collections import deque
from typing import Any, Deque, Iterator

import cv2
import numpy as np

import groundlock
from groundlock import CameraModel, Frame, FrameResult, TargetState

COLOURS = {
    TargetState.TRACKED: (80, 220, 80),
    TargetState.PREDICTED: (0, 165, 255),
    TargetState.LOST: (60, 60, 230),
}


def frames(capture: Any, shown: Deque[Any]) -> Iterator[Frame]:
    """Runs in a thread of the stream; what it hands over is kept to be shown."""
    while True:
        ok, image = capture.read()
        if not ok:
            return
        shown.append(image)
        # The time of the video; a camera's would be the moment of the exposure.
        yield Frame(image, capture_time_ns=round(1e6 * capture.get(cv2.CAP_PROP_POS_MSEC)))


def draw(image: Any, result: FrameResult, camera: CameraModel) -> None:
    """The 2D box, and the corners of the 3D box as far as they are in view."""
    for target in result.targets:
        colour = COLOURS[target.state]
        if target.box is not None:
            x, y, w, h = (round(v) for v in target.box.as_tuple())
            cv2.rectangle(image, (x, y), (x + w, y + h), colour, 2)
        pose = result.camera.world_from_camera
        if target.box_world is None or pose is None:
            continue
        p = pose.inverse().apply(target.box_world.corners())
        if (p[:, 2] <= 0.1).any():
            continue
        f, cx, cy = camera.params[0], camera.width_px / 2, camera.height_px / 2
        xy = np.rint(f * p[:, :2] / p[:, 2:] + (cx, cy)).astype(int)
        for a, b in [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]:
            cv2.line(image, tuple(map(int, xy[a])), tuple(map(int, xy[b])), colour, 1, cv2.LINE_AA)
    text = f"{result.sequence}: camera {result.camera.state.value}, {result.times.total_ms:.1f} ms"
    cv2.putText(image, text, (12, 28), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (255, 255, 255), 2, cv2.LINE_AA)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("input")
    parser.add_argument("camera")
    parser.add_argument("map")
    parser.add_argument("box", help="X,Y,W,H in the first frame")
    parser.add_argument("--server", help="HOST:PORT; without it the one on this machine, or one of its own")
    parser.add_argument("--show", action="store_true")
    parser.add_argument("--save")
    args = parser.parse_args()

    camera = CameraModel.read(args.camera)
    capture = cv2.VideoCapture(args.input)
    shown: Deque[Any] = deque()
    writer = None
    count = 0
    with groundlock.connect(args.server) as client:
        with client.create_session(map=args.map, camera=camera) as session:
            session.set_target("car", [float(v) for v in args.box.split(",")], sequence=0)
            for answer in session.track(frames(capture, shown)):
                image = shown.popleft()  # one answer per frame, in order
                if isinstance(answer, FrameResult):
                    draw(image, answer, camera)
                    count += 1
                if args.save and writer is None:
                    size = (image.shape[1], image.shape[0])
                    fps = capture.get(cv2.CAP_PROP_FPS) or 25.0
                    writer = cv2.VideoWriter(args.save, cv2.VideoWriter_fourcc(*"mp4v"), fps, size)
                if writer is not None:
                    writer.write(image)
                if args.show:
                    cv2.imshow("groundlock", image)
                    if cv2.waitKey(1) == 27:
                        break
    if writer is not None:
        writer.release()
    print(f"{count} frames")


if __name__ == "__main__":
    main()
