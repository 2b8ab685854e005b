# SPDX-License-Identifier: Apache-2.0
"""Streams against the real server: order, resuming, back-pressure, drops."""
from __future__ import annotations

import threading
import time

import numpy as np
import pytest

import groundlock as gl
from support import until


def frames_of(video_frames):
    return [gl.Frame(f.image, f.number, f.capture_time_ns) for f in video_frames]


def poses(answers):
    """What must not depend on the network."""
    return [
        (
            a.sequence,
            a.camera.state,
            a.camera.world_from_camera and tuple(a.camera.world_from_camera.translation),
            [(t.target_id, t.state, t.box) for t in a.targets],
        )
        for a in answers
    ]


@pytest.fixture(scope="module")
def reference(shared_server, camera, frames, scene):
    """The answers over a network that nobody cuts."""
    with gl.Client(shared_server.address) as client:
        with client.create_session(map="yard", camera=camera) as session:
            session.set_target("car", scene.box, sequence=0)
            return list(session.track(frames_of(frames)))


def test_every_frame_is_answered_once_in_order(reference, frames, scene):
    assert [a.sequence for a in reference] == [f.number for f in frames]
    assert all(isinstance(a, gl.FrameResult) for a in reference)
    tracked = [a for a in reference if a.camera.state is gl.CameraState.TRACKED]
    assert len(tracked) > len(reference) // 2
    for result in tracked:
        pose = result.camera.world_from_camera
        truth = [float(scene.truth[result.sequence][f"cam_{n}"]) for n in "xyz"]
        assert np.linalg.norm(pose.translation - truth) < 0.1
        row = scene.truth[result.sequence]
        q = [float(row[f"q_{n}"]) for n in "wxyz"] if "q_w" in row else None
        if q is not None:
            assert pose.rotation.angle_to(gl.Quaternion(*q)) < 0.02
        assert result.camera.covariance.shape == (6, 6)
        assert np.linalg.eigvalsh(result.camera.covariance).min() > 0
    boxes = [a.target("car").box for a in reference]
    truth = [gl.Box2(*(float(scene.truth[a.sequence][f"box_{n}"]) for n in "xywh")) for a in reference]
    assert np.mean([b.iou(t) for b, t in zip(boxes, truth)]) > 0.5


def test_a_body_that_is_told_is_there_from_the_first_frame(client, camera, frames, scene):
    told = {
        "sized": gl.TargetBody(size_m=(0.9, 0.5, 0.35)),
        "kind": "car",  # of 4.5 m: what was told is believed
        "neither": None,
    }
    with client.create_session(map="yard", camera=camera) as session:
        for name, body in told.items():
            session.set_target(name, scene.box, sequence=0, body=body)
        first = next(iter(session.track(frames_of(frames)[:1])))
    assert first.target("sized").body_kind is None
    assert np.allclose(first.target("sized").box_world.size_m, (0.9, 0.5, 0.35), rtol=0.15)
    assert first.target("kind").body_kind is gl.BodyKind.CAR
    assert first.target("neither").body_kind is None


def test_cut_connections_change_nothing(client, network, camera, frames, scene, reference):
    with gl.Client(network.address) as far:
        session = far.create_session(map="yard", camera=camera)
        session.set_target("car", scene.box, sequence=0)
        answers = []
        with session.stream(gl.StreamOptions(max_in_flight=4)) as stream:
            for answer in stream.process(frames_of(frames)):
                answers.append(answer)
                if len(answers) in (3, 9, 15):
                    network.cut()
                    if len(answers) == 9:
                        # Gone for a while: attempts fail until it is back.
                        network.up = False
                        threading.Timer(0.5, setattr, (network, "up", True)).start()
            assert stream.num_reconnects >= 2
    # Not over the connection that was just cut: a call under way goes with it.
    client.session(session.id).delete()
    assert poses(answers) == poses(reference)


def test_a_cut_in_the_middle_of_a_frame(network, camera, frames, scene, reference):
    with gl.Client(network.address) as far:
        with far.create_session(map="yard", camera=camera) as session:
            session.set_target("car", scene.box, sequence=0)
            with session.stream() as stream:
                sent = frames_of(frames)[:8]

                def feed():
                    for frame in sent:
                        stream.send(frame)
                    stream.close_send()

                # By the network itself: who watches it may come too late.
                size = len(gl.Image.of(frames[0].image).data)
                network.cut_at = network.bytes_up + 3 * size // 2
                threading.Thread(target=feed, daemon=True).start()
                answers = list(stream)
                assert network.cut_at is None
                assert stream.num_reconnects == 1
    assert poses(answers) == poses(reference[:8])


def test_a_killed_server_ends_the_stream_and_not_the_client(
    own_server, camera, frames, scene
):
    server = own_server()
    with gl.Client(server.address) as client:
        session = client.create_session(map="yard", camera=camera)
        with session.stream() as stream:
            stream.send(gl.Frame(frames[0].image, 0, 0))
            assert stream.receive(timeout_s=120).sequence == 0
            server.kill()
            stream.send(gl.Frame(frames[1].image, 1, 1))
            with pytest.raises(gl.DeadlineExceededError):
                stream.receive(timeout_s=0.5)
            server.start()
            # Its sessions went with it, and the stream says so.
            with pytest.raises(gl.NotFoundError) as caught:
                stream.receive(timeout_s=120)
            assert session.id in str(caught.value)
        # The same client works with the new server.
        with client.create_session(map="yard", camera=camera) as again:
            answers = list(again.track(frames_of(frames)[:3]))
        assert [a.sequence for a in answers] == [0, 1, 2]


def test_a_server_that_stays_away_is_given_up(own_server, camera, frames):
    server = own_server()
    with gl.Client(server.address) as client:
        session = client.create_session(map="yard", camera=camera)
        options = gl.StreamOptions(give_up_after_s=0.6, last_backoff_s=0.2)
        with session.stream(options) as stream:
            stream.send(gl.Frame(frames[0].image, 0, 0))
            stream.receive(timeout_s=120)
            server.kill()
            with pytest.raises(gl.UnavailableError, match="could not be restored"):
                stream.receive(timeout_s=120)
            with pytest.raises(gl.UnavailableError):
                stream.send(gl.Frame(frames[2].image, 2, 2))


def test_a_connection_may_hold_for_longer_than_it_is_sought(network, camera, frames):
    with gl.Client(network.address) as far:
        with far.create_session(map=None, camera=camera) as session:
            with session.stream(gl.StreamOptions(give_up_after_s=8.0)) as stream:
                stream.send(frames[0].image)
                stream.receive(timeout_s=120)
                time.sleep(8.2)
                network.cut()
                stream.send(frames[1].image)
                assert stream.receive(timeout_s=120).sequence == 1
                assert stream.num_reconnects == 1


def test_a_client_that_comes_back_goes_on(client, camera, frames, scene, reference):
    session = client.create_session(map="yard", camera=camera, session_id="resumed")
    session.set_target("car", scene.box, sequence=0)
    with session.stream() as stream:
        assert stream.next_sequence == 0
        first = list(stream.process(frames_of(frames)[:5]))
    again = client.session("resumed")
    with again.stream() as stream:
        assert stream.next_sequence == 5
        rest = list(stream.process(frames_of(frames)[5:10]))
    again.delete()
    assert poses(first + rest) == poses(reference[:10])


def test_sending_waits_while_answers_are_not_taken(client, camera, frames):
    with client.create_session(map=None, camera=camera) as session:
        with session.stream(gl.StreamOptions(max_in_flight=2)) as stream:
            stream.send(frames[0].image)
            stream.send(frames[1].image)
            with pytest.raises(gl.DeadlineExceededError, match="frame 2: 2 frames"):
                stream.send(frames[2].image, timeout_s=0.3)
            assert stream.in_flight == 2
            assert stream.receive(timeout_s=120).sequence == 0
            assert stream.send(frames[2].image, timeout_s=120) == 2
            stream.close_send()
            assert [a.sequence for a in stream] == [1, 2]
            assert stream.receive() is None
            with pytest.raises(gl.FailedPreconditionError, match="ended"):
                stream.send(frames[3].image)


def test_live_sessions_report_what_they_drop(client, camera, frames):
    options = gl.SessionOptions(flow_mode="live")
    # A small file is sent in a fraction of the time that the server needs to
    # decode it, however busy the machine is.
    image = gl.Image.jpeg(frames[0].image, quality=20)
    count = 200
    with client.create_session(map="yard", camera=camera, options=options) as session:
        answers = list(
            session.track(
                (gl.Frame(image, n, n * 41_666_667) for n in range(count)),
                gl.StreamOptions(max_in_flight=count),
            )
        )
        assert [a.sequence for a in answers] == list(range(count))
        dropped = [a for a in answers if isinstance(a, gl.FrameDropped)]
        assert dropped and all(d.reason is gl.DropReason.OVERLOAD for d in dropped)
        assert session.info().frames_dropped == len(dropped)


def test_a_frame_that_fails_does_not_end_the_session(client, camera, frames):
    with client.create_session(map="yard", camera=camera) as session:
        wrong = [frames[0].image, b"\xff\xd8 no picture", frames[1].image[:-2], frames[2].image]
        answers = list(session.track(wrong))
    kinds = [type(a) for a in answers]
    assert kinds == [gl.FrameResult, gl.FrameFailed, gl.FrameFailed, gl.FrameResult]
    assert answers[1].error.code is gl.Code.INVALID_ARGUMENT
    assert "size" in str(answers[2].error) or "x" in str(answers[2].error)


def test_the_newer_stream_takes_over(client, camera, frames):
    with client.create_session(map=None, camera=camera) as session:
        with session.stream() as old:
            old.send(frames[0].image)
            old.receive(timeout_s=120)
            with session.stream() as new:
                with pytest.raises(gl.AbortedError):
                    old.receive(timeout_s=120)
                assert new.next_sequence == 1
                new.send(frames[1].image)
                assert new.receive(timeout_s=120).sequence == 1


def test_a_deleted_session_ends_its_stream_and_watchers(client, camera, frames):
    session = client.create_session(map=None, camera=camera)
    with session.watch(include_images=True) as watcher, session.stream() as stream:
        stream.send(frames[0].image)
        stream.receive(timeout_s=120)
        update = next(watcher)
        assert update.result.sequence == 0 and update.skipped == 0
        assert update.image.to_array().shape == frames[0].image.shape
        session.delete()
        assert list(watcher) == []
        with pytest.raises(gl.NotFoundError):
            stream.receive(timeout_s=120)
    with pytest.raises(gl.NotFoundError):
        session.stream()
    with pytest.raises(gl.NotFoundError):
        session.watch()


def test_cancelling_wakes_who_waits(client, camera):
    with client.create_session(map=None, camera=camera) as session:
        stream = session.stream()
        threading.Timer(0.3, stream.cancel).start()
        started = time.monotonic()
        with pytest.raises(gl.StreamCancelledError):
            stream.receive()
        assert time.monotonic() - started < 60
        watcher = session.watch()
        threading.Timer(0.3, watcher.cancel).start()
        with pytest.raises(gl.StreamCancelledError):
            next(watcher)


def test_what_the_frames_raise_comes_after_their_answers(client, camera, frames):
    def broken():
        yield frames[0].image
        yield frames[1].image
        raise RuntimeError("the camera is gone")

    answers = []
    with client.create_session(map=None, camera=camera) as session:
        with pytest.raises(RuntimeError, match="the camera is gone"):
            for answer in session.track(broken()):
                answers.append(answer.sequence)
        assert answers == [0, 1]
        # Leaving early ends the stream, and the session can be used again.
        for answer in session.track(f.image for f in frames):
            assert answer.sequence == 2
            break
        with session.stream() as stream:
            assert stream.next_sequence >= 3


def test_a_forgotten_stream_ends_by_itself(client, camera):
    with client.create_session(map=None, camera=camera) as session:
        stream = session.stream()
        assert session.info().streaming
        del stream
        until("the end of the stream", lambda: not session.info().streaming)
