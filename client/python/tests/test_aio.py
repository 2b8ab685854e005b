# SPDX-License-Identifier: Apache-2.0
"""The asyncio client against the real server: what the plain one does, without
threads of the caller's."""
from __future__ import annotations

import asyncio

import numpy as np
import pytest

import groundlock as gl
from groundlock import aio
from test_stream import frames_of, poses


class Stop(Exception):
    pass


def test_maps(shared_server, scene, tmp_path):
    async def run():
        async with await aio.connect(shared_server.address) as client:
            steps = []
            report = await client.import_map(
                "of-asyncio", scene.map, align=scene.align, on_progress=steps.append
            )
            assert report.map == await client.get_map("of-asyncio")
            assert "of-asyncio" in [m.name for m in await client.list_maps()]
            assert (await client.check_map("of-asyncio")).problems == ()
            cloud = await client.point_cloud("of-asyncio", max_points=50)
            assert 0 < len(cloud.xyz_world) <= 50
            await client.export_map(
                "of-asyncio", tmp_path / "out.glmap", format="groundlock", on_progress=steps.append
            )
            assert steps[-1].stage == "downloading" and steps[-1].fraction == 1
            double = gl.SimilarityTransform(2, gl.Quaternion.identity(), [0, 0, 0])
            aligned = await client.align_map("of-asyncio", gl.NewWorldFromWorld(double))
            assert aligned.map.version == 2
            await client.delete_map("of-asyncio")
            with pytest.raises(gl.NotFoundError, match="of-asyncio"):
                await client.get_map("of-asyncio")

            def stop(progress):
                raise Stop

            with pytest.raises(Stop):
                await client.import_map("stopped", scene.map, on_progress=stop)
            with pytest.raises(Stop):
                await client.build_map("stopped", video=scene.video, on_progress=stop)
            with pytest.raises(gl.NotFoundError):
                await client.get_map("stopped")
            with pytest.raises(gl.GroundlockError):
                await client.build_map("stopped", images=[scene.camera])

    asyncio.run(run())


def test_cut_connections_change_nothing(shared_server, network, camera, frames, scene):
    async def through(address, cuts):
        async with await aio.connect(address) as client:
            async with await client.create_session(map="yard", camera=camera) as session:
                await session.set_target("car", scene.box, sequence=0)
                async with await session.stream(gl.StreamOptions(max_in_flight=4)) as stream:
                    answers = []
                    async for answer in stream.process(frames_of(frames)):
                        answers.append(answer)
                        if len(answers) in cuts:
                            network.cut()
                    return answers, stream.num_reconnects

    reference, none = asyncio.run(through(shared_server.address, ()))
    assert none == 0 and len(reference) == len(frames)
    answers, reconnects = asyncio.run(through(network.address, (2, 9)))
    assert reconnects >= 2
    assert poses(answers) == poses(reference)


def test_a_killed_server(own_server, camera, frames):
    server = own_server()

    async def run():
        async with await aio.connect(server.address) as client:
            session = await client.create_session(map=None, camera=camera)
            async with await session.stream() as stream:
                await stream.send(frames[0].image)
                assert (await stream.receive(timeout_s=120)).sequence == 0
                server.kill()
                await stream.send(frames[1].image)
                with pytest.raises(gl.DeadlineExceededError):
                    await stream.receive(timeout_s=0.3)
                server.start()
                with pytest.raises(gl.NotFoundError):
                    await stream.receive(timeout_s=120)
            async with await client.create_session(map=None, camera=camera) as again:
                answers = [a async for a in again.track(f.image for f in frames[:3])]
            assert [a.sequence for a in answers] == [0, 1, 2]

    asyncio.run(run())


def test_back_pressure_watching_and_cancelling(shared_server, camera, frames):
    async def run():
        async with await aio.connect(shared_server.address) as client:
            session = await client.create_session(map=None, camera=camera)
            watcher = await session.watch()
            async with await session.stream(gl.StreamOptions(max_in_flight=2)) as stream:
                await stream.send(frames[0].image)
                await stream.send(frames[1].image)
                with pytest.raises(gl.DeadlineExceededError, match="2 frames"):
                    await stream.send(frames[2].image, timeout_s=0.3)
                assert (await stream.receive()).sequence == 0
                assert await stream.send(frames[2].image, timeout_s=120) == 2
                with pytest.raises(gl.InvalidArgumentError, match="frame.sequence"):
                    await stream.send(gl.Frame(frames[2].image, 1))
                await stream.close_send()
                assert [a.sequence async for a in stream] == [1, 2]
            assert (await watcher.__anext__()).result.sequence in (0, 1, 2)
            info = await session.info()
            assert info.frames_processed == 3 and info.target_ids == ()
            assert session.id in [s.session_id for s in await client.list_sessions()]

            async def frames_later():
                for f in frames[3:5]:
                    await asyncio.sleep(0.05)
                    yield f.image
                raise Stop

            seen = []
            with pytest.raises(Stop):
                async for answer in session.track(frames_later()):
                    seen.append(answer.sequence)
            assert seen == [3, 4]
            stream = await session.stream()
            waiting = asyncio.ensure_future(stream.receive())
            await asyncio.sleep(0.1)
            await stream.cancel()
            with pytest.raises(gl.StreamCancelledError):
                await waiting
            await session.delete()
            async for _ in watcher:
                pass  # ends with the session
            with pytest.raises(gl.NotFoundError):
                await session.stream()

    asyncio.run(run())


def test_two_sessions_at_a_time_and_single_images(shared_server, camera, frames, scene):
    async def follow(client, name):
        async with await client.create_session(map="yard", camera=camera) as session:
            await session.set_target(name, scene.box, sequence=0)
            return [a async for a in session.track(frames_of(frames)[:6])]

    async def run():
        async with await aio.connect(shared_server.address) as client:
            a, b, image = await asyncio.gather(
                follow(client, "car"),
                follow(client, "car"),
                client.localize(frames[0].image, map="yard", camera=camera),
            )
            assert poses(a) == poses(b)
            assert image.camera.state is gl.CameraState.TRACKED
            blank = np.zeros((camera.height_px, camera.width_px), np.uint8)
            nothing = await client.localize(blank, map="yard", camera=camera)
            assert nothing.camera.state is gl.CameraState.LOST

    asyncio.run(run())


def test_the_caller_and_an_alignment(shared_server, scene, monkeypatch):
    monkeypatch.setattr(aio, "_POLL_S", 1e-4)

    async def main():
        async with await gl.aio.connect(shared_server.address) as client:
            assert (await client.caller()).open_to_all
            await client.import_map("moved", scene.map, align=scene.align)
            told = []
            double = gl.SimilarityTransform(2.0, gl.Quaternion.identity(), [0, 0, 0])
            await client.align_map("moved", gl.NewWorldFromWorld(double), on_progress=told.append)
            assert (await client.get_map("moved")).version == 2
            assert {p.stage for p in told} == {"aligning"}
            await client.delete_map("moved")

    asyncio.run(main())


def test_nobody_answers():
    with pytest.raises(gl.UnavailableError, match="127.0.0.1:1:"):
        asyncio.run(aio.connect("127.0.0.1:1", connect_timeout_s=0.3))
