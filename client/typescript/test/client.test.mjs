// SPDX-License-Identifier: Apache-2.0
// The package as it is installed, against the real programs.
import assert from "node:assert/strict";
import { execFileSync, spawn } from "node:child_process";
import { chmodSync, existsSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import {
  BUILD, Code, COLUMNS, GroundlockError, LocalServer, Recording, Video, apply, compose, connect, corners, inverse, iou,
  inertialBetween, inertialSince, rawImage, readAlignment, readCamera, readImu, readInertial, rotate, rows, toMatrix, track, VERSION,
  writeCamera,
} from "groundlock";
import { BIN, Network, Server, folder, ownServer, scene, sharedServer, until } from "./support.mjs";

const COUNT = 16;
const TOKEN = "a-token-of-the-typescript-test";
delete process.env.GROUNDLOCK_TOKEN;

let server, client, camera, frames;
before(async () => {
  server = await sharedServer();
  client = await connect({ server: server.address });
  camera = readCamera(scene.camera);
  frames = [];
  for await (const frame of await Video.open(scene.video, { last: COUNT })) frames.push(frame);
});
after(async () => {
  await client?.close();
  await Server.stopAll();
});

const code = (wanted, words = /./) => (error) => {
  assert.ok(error instanceof GroundlockError, String(error?.stack ?? error));
  assert.equal(error.codeName, wanted, error.message);
  assert.match(error.message, words);
  return true;
};
const all = async (items) => {
  const list = [];
  for await (const item of items) list.push(item);
  return list;
};
/** What must not depend on the network. */
const poses = (answers) =>
  answers.map((a) => [
    a.sequence, a.camera.state, a.camera.worldFromCamera, a.targets.map((t) => [t.targetId, t.state, t.box]),
  ]);
/** A session that is deleted afterwards. */
async function within(owner, spec, use) {
  const session = await owner.createSession(spec);
  try {
    return await use(session);
  } finally {
    await session.delete().catch(() => undefined);
  }
}

test("which build it is", () => {
  const here = dirname(fileURLToPath(import.meta.url));
  const manifest = JSON.parse(readFileSync(join(here, "node_modules/groundlock/package.json"), "utf8"));
  assert.equal(VERSION, manifest.version);
  const commit = process.env.GROUNDLOCK_COMMIT;
  assert.equal(BUILD, commit ? `${VERSION} (${commit})` : VERSION);
});

let reference;
async function theReference() {
  return (reference ??= await within(client, { map: "yard", camera }, async (session) => {
    await session.setTarget("car", scene.box, { sequence: 0 });
    return all(session.track(frames));
  }));
}

// --- values -------------------------------------------------------------------

test("transforms are matrices", () => {
  const q = { w: Math.cos(0.4), x: 0, y: 0, z: Math.sin(0.4) };
  const a = { rotation: q, translation: [1, 2, 3] };
  const near = (x, y) => x.forEach((v, i) => assert.ok(Math.abs(v - y[i]) < 1e-12, `${x} ${y}`));
  near(rotate(q, [1, 0, 0]), [Math.cos(0.8), Math.sin(0.8), 0]);
  near(toMatrix(a), [Math.cos(0.8), -Math.sin(0.8), 0, 1, Math.sin(0.8), Math.cos(0.8), 0, 2, 0, 0, 1, 3, 0, 0, 0, 1]);
  near(toMatrix(compose(a, inverse(a))), [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
  near(apply({ ...a, scale: 2 }, [1, 0, 0]), [1 + 2 * Math.cos(0.8), 2 + 2 * Math.sin(0.8), 3]);
  const quarter = { w: Math.SQRT1_2, x: 0, y: 0, z: Math.SQRT1_2 };
  const box = corners({ worldFromObject: { rotation: quarter, translation: [1, 1, 0.5] }, sizeM: [4, 2, 1] });
  near([0, 1, 2].map((i) => Math.min(...box.map((p) => p[i]))), [0, -1, 0]);
  near([0, 1, 2].map((i) => Math.max(...box.map((p) => p[i]))), [2, 3, 1]);
  const b = { x: 10, y: 20, width: 30, height: 40 };
  assert.equal(iou(b, b), 1);
  assert.ok(Math.abs(iou(b, { ...b, x: 25 }) - 15 / 45) < 1e-12);
  const file = join(folder(), "camera.json");
  writeCamera(file, camera);
  assert.deepEqual(readCamera(file), camera);
});

// --- streams ------------------------------------------------------------------

test("every frame is answered once, in order, and rightly", async () => {
  const answers = await theReference();
  assert.deepEqual(answers.map((a) => [a.kind, a.sequence]), frames.map((f) => ["result", f.sequence]));
  const tracked = answers.filter((a) => a.camera.state === "TRACKED");
  assert.ok(tracked.length > COUNT / 2);
  for (const { sequence, camera: found } of tracked) {
    const truth = ["x", "y", "z"].map((n) => scene.truth[sequence][`cam_${n}`]);
    const error = Math.hypot(...found.worldFromCamera.translation.map((v, i) => v - truth[i]));
    assert.ok(error < 0.1, `frame ${sequence}: ${error}`);
    assert.equal(found.covariance.length, 36);
  }
  const overlaps = answers.map((a) => {
    const row = scene.truth[a.sequence];
    return iou(a.targets[0].box, { x: row.box_x, y: row.box_y, width: row.box_w, height: row.box_h });
  });
  assert.ok(overlaps.reduce((x, y) => x + y) / COUNT > 0.5);
});

test("cut connections change nothing", async () => {
  const network = await Network.to(server.port);
  const far = await connect({ server: network.address });
  const answers = [];
  const reconnects = await within(far, { map: "yard", camera }, async (session) => {
    await session.setTarget("car", scene.box, { sequence: 0 });
    const stream = await session.stream({ maxInFlight: 4 });
    for await (const answer of stream.process(frames)) {
      answers.push(answer);
      if (![2, 7, 12].includes(answers.length)) continue;
      network.cut();
      if (answers.length === 7) {
        // Gone for a while: attempts fail until it is back.
        network.up = false;
        setTimeout(() => (network.up = true), 400);
      }
    }
    await stream.cancel();
    return stream.numReconnects;
  });
  await far.close();
  network.close();
  assert.ok(reconnects >= 2, `${reconnects}`);
  assert.deepEqual(poses(answers), poses(await theReference()));
});

test("a cut in the middle of a frame", async () => {
  const network = await Network.to(server.port);
  const far = await connect({ server: network.address });
  await within(far, { map: "yard", camera }, async (session) => {
    await session.setTarget("car", scene.box, { sequence: 0 });
    const stream = await session.stream();
    // By the network itself: who watches it may come too late.
    network.cutAt = network.bytesUp + 1.5 * frames[0].image.data.length;
    for (const frame of frames.slice(0, 6)) await stream.send(frame);
    stream.closeSend();
    const answers = await all(stream);
    assert.equal(stream.numReconnects, 1);
    assert.deepEqual(poses(answers), poses((await theReference()).slice(0, 6)));
  });
  await far.close();
  network.close();
});

test("a connection may hold for longer than it is sought", async () => {
  const network = await Network.to(server.port);
  const far = await connect({ server: network.address });
  await within(far, { map: null, camera }, async (session) => {
    const stream = await session.stream({ giveUpAfterMs: 8000, lastBackoffMs: 800 });
    await stream.send({ image: frames[0].image });
    await stream.receive();
    await new Promise((done) => setTimeout(done, 8200));
    network.cut();
    await stream.send({ image: frames[1].image });
    assert.equal((await stream.receive({ timeoutMs: 120_000 })).sequence, 1);
    assert.equal(stream.numReconnects, 1);
    await stream.cancel();
  });
  await far.close();
  network.close();
});

test("a killed server ends the stream and not the client", async () => {
  const own = await ownServer();
  const owner = await connect({ server: own.address });
  const session = await owner.createSession({ map: "yard", camera });
  const stream = await session.stream();
  await stream.send(frames[0]);
  assert.equal((await stream.receive({ timeoutMs: 120_000 })).sequence, 0);
  await own.kill();
  await stream.send(frames[1]);
  await assert.rejects(stream.receive({ timeoutMs: 300 }), code("DEADLINE_EXCEEDED"));
  await own.start();
  // Its sessions went with it, and the stream says so.
  await assert.rejects(stream.receive({ timeoutMs: 120_000 }), code("NOT_FOUND", new RegExp(session.id)));
  const answers = await within(owner, { map: "yard", camera }, (again) => all(again.track(frames.slice(0, 3))));
  assert.deepEqual(answers.map((a) => a.sequence), [0, 1, 2]);
  const last = await owner.createSession({ map: null, camera });
  const given = await last.stream({ giveUpAfterMs: 500, lastBackoffMs: 200 });
  await given.send(frames[0]);
  await given.receive();
  await own.kill();
  await assert.rejects(given.receive({ timeoutMs: 120_000 }), code("UNAVAILABLE", /could not be restored/));
  await owner.close();
});

test("a client that comes back goes on; the newer stream takes over", async () => {
  const session = await client.createSession({ map: "yard", camera, sessionId: "resumed" });
  await session.setTarget("car", scene.box, { sequence: 0 });
  const first = await all(session.track(frames.slice(0, 4)));
  const again = await client.session("resumed");
  const stream = await again.stream();
  assert.equal(stream.nextSequence, 4);
  const rest = await all(stream.process(frames.slice(4, 8)));
  assert.deepEqual(poses([...first, ...rest]), poses((await theReference()).slice(0, 8)));
  const old = await again.stream();
  const newer = await again.stream();
  await assert.rejects(old.receive({ timeoutMs: 120_000 }), code("ABORTED"));
  await newer.cancel();
  await session.delete();
});

test("back-pressure, drops, failures, endings", async () => {
  await within(client, { map: null, camera }, async (session) => {
    const stream = await session.stream({ maxInFlight: 2 });
    await stream.send({ image: frames[0].image });
    await stream.send({ image: frames[1].image });
    await assert.rejects(stream.send({ image: frames[2].image }, { timeoutMs: 300 }), code("DEADLINE_EXCEEDED", /frame 2: 2 frames/));
    assert.equal((await stream.receive()).sequence, 0);
    assert.equal(await stream.send({ image: frames[2].image }), 2);
    await assert.rejects(stream.send({ image: frames[2].image, sequence: 1 }), code("INVALID_ARGUMENT", /frame.sequence: 1 is below 3/));
    stream.closeSend();
    assert.deepEqual((await all(stream)).map((a) => a.sequence), [1, 2]);
    await assert.rejects(stream.send({ image: frames[2].image }), code("FAILED_PRECONDITION", /ended/));
    assert.equal((await session.info()).framesProcessed, 3);
    // What the frames throw comes after their answers.
    async function* broken() {
      yield { image: frames[3].image };
      throw new RangeError("the camera is gone");
    }
    const seen = [];
    await assert.rejects(async () => {
      for await (const answer of session.track(broken())) seen.push(answer.sequence);
    }, /the camera is gone/);
    assert.deepEqual(seen, [3]);
    // Leaving early ends the stream, and the session can be used again.
    for await (const answer of session.track(frames.map(({ image }) => ({ image })))) {
      assert.equal(answer.sequence, 4);
      break;
    }
    const waiting = await session.stream();
    setTimeout(() => void waiting.cancel(), 100);
    await assert.rejects(waiting.receive(), code("CANCELLED"));
  });
  // The thorough localizer takes longer for a frame than all of them to arrive.
  await within(client, { map: "yard", camera, options: { flowMode: "live", localizer: "baseline" } }, async (session) => {
    const answers = await all(session.track(frames, { maxInFlight: COUNT }));
    assert.deepEqual(answers.map((a) => a.sequence), frames.map((f) => f.sequence));
    const dropped = answers.filter((a) => a.kind === "dropped");
    assert.ok(dropped.length > 0 && dropped.every((d) => d.reason === "overload"));
    assert.equal((await session.info()).framesDropped, dropped.length);
  });
  await within(client, { map: "yard", camera }, async (session) => {
    const small = rawImage("gray8", new Uint8Array(64 * 48), 64, 48);
    const wrong = [frames[0].image, Buffer.from("\xff\xd8 no picture", "latin1"), small, frames[1].image];
    const answers = await all(session.track(wrong.map((image) => ({ image }))));
    assert.deepEqual(answers.map((a) => a.kind), ["result", "failed", "failed", "result"]);
    assert.equal(answers[1].error.code, Code.INVALID_ARGUMENT);
  });
});

test("watching, and the end of a session", async () => {
  const session = await client.createSession({ map: null, camera });
  const watcher = await session.watch({ includeImages: true });
  const stream = await session.stream();
  await stream.send(frames[0]);
  await stream.receive();
  const updates = watcher[Symbol.asyncIterator]();
  const { value } = await updates.next();
  assert.equal(value.result.sequence, 0);
  assert.equal(value.skipped, 0);
  assert.equal(value.image.data[0], 0xff); // as JPEG
  await session.delete();
  assert.equal((await updates.next()).done, true);
  await assert.rejects(stream.receive({ timeoutMs: 120_000 }), code("NOT_FOUND"));
  await assert.rejects(session.stream(), code("NOT_FOUND"));
  await assert.rejects(session.watch(), code("NOT_FOUND"));
  assert.ok(!(await client.listSessions()).some((s) => s.sessionId === session.id));
});

// --- maps ---------------------------------------------------------------------

test("maps: import, show, export, align, delete", async () => {
  const steps = [];
  const { map } = await client.importMap("imported", scene.map, { align: scene.align, onProgress: (p) => steps.push(p) });
  assert.equal(map.version, 1);
  assert.ok(map.metric && map.hasDescriptors && map.createTime > new Date(2020, 1));
  const align = readAlignment(scene.align);
  assert.ok(Math.abs(map.worldFromSource.scale - align.scale) < 1e-9);
  assert.ok(steps.every((s) => s.fraction >= 0 && s.fraction <= 1 && s.bytesTotal > 0));
  assert.deepEqual(await client.getMap("imported", 1), map);
  assert.ok((await client.listMaps()).some((m) => m.name === "imported"));
  assert.deepEqual((await client.checkMap("imported")).problems, []);
  const cloud = await client.pointCloud("imported");
  assert.equal(cloud.xyzWorld.length, 3 * map.numLandmarks);
  assert.equal(cloud.rgb.length, 3 * map.numLandmarks);
  assert.equal(cloud.cameras.length, map.numViews);
  assert.ok((await client.pointCloud("imported", { maxPoints: 50 })).xyzWorld.length <= 150);

  const out = folder();
  const told = [];
  await client.exportMap("imported", join(out, "map.glmap"), { format: "groundlock", onProgress: (p) => told.push(p) });
  assert.equal(told.at(-1).fraction, 1);
  assert.equal((await client.importMap("again", join(out, "map.glmap"))).map.contentHash, map.contentHash);
  await client.exportMap("imported", join(out, "colmap"));
  assert.equal((await client.importMap("again", join(out, "colmap"))).map.numLandmarks, map.numLandmarks);
  await assert.rejects(client.exportMap("imported", join(out, "colmap")), code("ALREADY_EXISTS"));
  await assert.rejects(client.exportMap("nowhere", join(out, "none")), code("NOT_FOUND"));
  await assert.rejects(
    client.exportMap("imported", join(out, "none"), { onProgress: () => { throw new RangeError("stop"); } }), /stop/);
  assert.deepEqual(readdirSync(out).sort(), ["colmap", "map.glmap"]);

  const [a, b] = [cloud.cameras[0], cloud.cameras.at(-1)].map((c) => c.worldFromCamera.translation);
  const distanceM = 2 * Math.hypot(...a.map((v, i) => v - b[i]));
  const known = { knownDistance: { from: { positionWorld: a }, to: { positionWorld: b }, distanceM } };
  const report = await client.alignMap("imported", known, { reportOnly: true });
  assert.ok(Math.abs(report.newWorldFromWorld.scale - 2) < 1e-6);
  assert.equal((await client.getMap("imported")).version, 1);
  const move = { scale: 1.5, rotation: { w: Math.cos(0.35), x: 0, y: 0, z: Math.sin(0.35) }, translation: [10, -4, 0] };
  const places = Object.fromEntries(cloud.cameras.map((c) => [c.name, apply(move, c.worldFromCamera.translation)]));
  const moved = await client.alignMap("imported", { cameraPositions: places, accuracyM: 0.1 });
  assert.equal(moved.map.version, 2);
  assert.ok(moved.rmsErrorM < 1e-3 && moved.residuals.every((r) => r.used));
  const origin = { latitudeDeg: 58.4, longitudeDeg: 15.6, heightM: 80 };
  assert.deepEqual((await client.alignMap("imported", { newWorldFromSource: align }, { origin })).map.origin, origin);
  for (const name of ["imported", "again"]) await client.deleteMap(name);
  await assert.rejects(client.getMap("imported"), code("NOT_FOUND", /imported/));

  // An alignment has no stages; a callback is asked now and then, and may end it.
  await client.importMap("slow", scene.map, { align: scene.align });
  const stages = new Set();
  const double = { newWorldFromWorld: { scale: 2, rotation: { w: 1, x: 0, y: 0, z: 0 }, translation: [0, 0, 0] } };
  await client.alignMap("slow", double, { onProgress: (p) => stages.add(p.stage) });
  assert.equal((await client.getMap("slow")).version, 2);
  assert.ok([...stages].every((stage) => stage === "aligning"));
  await client.deleteMap("slow");
});

test("a callback that throws ends the upload", async () => {
  const onProgress = () => { throw new RangeError("enough"); };
  await assert.rejects(client.importMap("stopped", scene.map, { onProgress }), /enough/);
  await assert.rejects(client.buildMap("stopped", { video: scene.video, onProgress }), /enough/);
  await assert.rejects(client.getMap("stopped"), code("NOT_FOUND"));
  await assert.rejects(client.buildMap("stopped", { images: [scene.camera] }), (error) => error instanceof GroundlockError);
});

test("builds tell their stages", async () => {
  const steps = [];
  const build = () => client.buildMap("building", {
    video: scene.video, maxImages: 8,
    onProgress: (p) => {
      steps.push(p);
      if (!["uploading", "preparing"].includes(p.stage)) throw new RangeError("seen");
    },
  });
  // A build that was given up before may still be ending; the server takes one at a time.
  const free = async (error) => {
    if (error.code !== Code.RESOURCE_EXHAUSTED) throw error;
    await new Promise((resolve) => setTimeout(resolve, 50));
    return build().catch(free);
  };
  await assert.rejects(build().catch(free), /seen/);
  assert.ok(steps.at(-1).fraction <= 1);
});

test("single images are localised", async () => {
  const { camera: found } = await client.localize(frames[0].image, { map: "yard", camera });
  assert.equal(found.state, "TRACKED");
  const truth = ["x", "y", "z"].map((n) => scene.truth[0][`cam_${n}`]);
  assert.ok(Math.hypot(...found.worldFromCamera.translation.map((v, i) => v - truth[i])) < 0.1);
  const prior = { positionM: truth, positionSigmaM: 1, rotation: found.worldFromCamera.rotation, rotationSigmaRad: 0.1 };
  assert.equal((await client.localize(frames[0].image, { map: "yard", camera: scene.camera, prior })).camera.state, "TRACKED");
  const blank = rawImage("gray8", new Uint8Array(camera.widthPx * camera.heightPx), camera.widthPx, camera.heightPx);
  const nothing = (await client.localize(blank, { map: "yard" })).camera;
  assert.equal(nothing.state, "LOST");
  assert.equal(nothing.worldFromCamera, undefined);
});

// --- arguments ----------------------------------------------------------------

test("a wrong argument is named, and so is what would be right", async () => {
  const session = await client.createSession({ map: null, camera });
  const stream = await session.stream();
  const cases = [
    [() => client.createSession({ map: null, camera: { ...camera, model: "PINHOL" } }), "camera.model", /one of SIMPLE_PINHOLE/],
    [() => client.createSession({ map: null, camera: { ...camera, params: [1, 2] } }), "camera.params", /2 given, but \w+ has \d: f/],
    [() => client.createSession({ map: null, camera: { ...camera, widthPx: 0 } }), "camera.widthPx", /in \[1, 65535\]/],
    [() => client.createSession({ map: null, camera: "/no/camera.json" }), "/no/camera.json", /cannot be read/],
    [() => client.createSession({ map: "a b", camera }), "map", /A-Z a-z/],
    [() => client.createSession({ map: null, camera, sessionId: "a b" }), "sessionId", /A-Z a-z/],
    [() => client.createSession({ map: null, camera, options: { flowMode: "liv" } }), "options.flowMode", /one of lossless, live/],
    [() => client.createSession({ map: null, camera, options: { confidenceThreshold: 1 } }), "options.confidenceThreshold", /\(0, 1\)/],
    [() => session.setTarget("a b", [1, 1, 2, 2]), "targetId", /A-Z a-z/],
    [() => session.setTarget("car", [1, 1, -2, 2]), "box.width", /above 0/],
    [() => session.setTarget("car", [1, 1, 2, 2], { body: { kind: "TANK" } }), "body.kind", /CAR/],
    [() => session.setTarget("car", [1, 1, 2, 2], { body: { sizeM: [1, 2] } }), "body.sizeM", /3/],
    [() => session.setTarget("car", [1, 1, 2, 2], { body: { sizeM: [1, 2, 0] } }), "body.sizeM", /above 0/],
    [() => session.setTarget("car", [1, 1, 2]), "box", /3 numbers, must have 4/],
    [() => session.setTarget("car", [1, 1, 2, 2], { sequence: -1 }), "sequence", /0 or more/],
    [() => session.watch({ imageWidthPx: -1 }), "imageWidthPx", /in \[0/],
    [() => session.stream({ maxInFlight: 257 }), "maxInFlight", /in \[1, 256\]/],
    [() => session.stream({ firstBackoffMs: 2, lastBackoffMs: 1 }), "lastBackoffMs", /below firstBackoffMs/],
    [() => stream.send({ image: 5 }), "frame.image", /bytes or path/],
    [() => stream.send({ image: { encoding: "rgb8", data: new Uint8Array(5), widthPx: 2, heightPx: 2 } }), "frame.image.data", /5 bytes, but 2x2 rgb8 has 12/],
    [() => stream.send({ image: frames[0].image, captureTimeNs: 5 }), "frame.captureTimeNs", /bigint/],
    [() => stream.send({ image: frames[0].image, inertial: 5 }), "frame.inertial", /array of InertialSample/],
    [() => stream.send({ image: frames[0].image, inertial: [{ timeNs: 5, angularRateRadS: [0, 0, 0] }] }), "frame.inertial[0].timeNs", /bigint/],
    [() => stream.send({ image: frames[0].image, inertial: [7n, 6n].map((timeNs) => ({ timeNs, angularRateRadS: [0, 0, 0] })) }), "frame.inertial[1].timeNs", /6 is not above 7/],
    [() => stream.send({ image: frames[0].image, inertial: [{ timeNs: 5n, angularRateRadS: [0, 0] }] }), "frame.inertial[0].angularRateRadS", /must have 3/],
    [() => client.createSession({ map: null, options: { imu: { imuFromCamera: { w: 0, x: 0, y: 0, z: 0 } } } }), "options.imu.imuFromCamera", /length 0/],
    [() => client.createSession({ map: null, options: { imu: { imuFromCamera: { w: 1, x: 0, y: 0, z: 0 }, gyroscopeBiasRadS: -1 } } }), "options.imu.gyroscopeBiasRadS", /negative/],
    [() => track(scene.video, { map: "yard", imu: "imu.json" }), "inertial", /missing/],
    [() => track(scene.video, { map: "yard", inertial: [] }), "imu", /missing/],
    [() => client.getMap("-x"), "name", /not start with/],
    [() => client.getMap("yard", 1.5), "version", /whole number/],
    [() => client.exportMap("yard", "/tmp/x", { format: "obj" }), "format", /one of colmap, colmap-text/],
    [() => client.importMap("yard", "/no/such"), "path", /no such file/],
    [() => client.importMap("yard", scene.camera), "path", /expected a folder with a COLMAP model/],
    [() => client.buildMap("yard", {}), "video", /either a video or images/],
    [() => client.alignMap("yard", {}), "method", /knownDistance/],
    [() => client.alignMap("yard", { cameraPositions: {} }), "cameraPositions", /3 or more/],
    [() => client.alignMap("yard", null, { ground: "auto" }), "ground", /"automatic"/],
    [() => client.localize(frames[0].image, { map: "yard", prior: { positionM: [0, 0, 0] } }), "prior.positionSigmaM", /above 0/],
    [() => client.createSession({ map: "yard", options: { cameraLostAfterS: -1 } }), "options.cameraLostAfterS", /\[0, 86400\]/],
    [() => client.localize(frames[0].image, { map: "yard", prior: { positionArmM: [0, 0, 0] } }), "prior.positionArmM", /goes with/],
    [() => connect({ server: "localhost" }), "server", /HOST:PORT/],
    [() => connect({ server: "http://localhost:1" }), "server", /grpcs:/],
    [() => connect({ server: "localhost:1", local: true }), "server", /local/],
    [() => connect({ server: "localhost:1", tls: { ca: "/no/ca" } }), "tls.ca", /cannot be read/],
    [() => connect({ server: "localhost:1", tls: { cert: scene.camera } }), "tls.key", /go together/],
    [() => connect({ server: "localhost:1", tokenFile: "/no/token" }), "tokenFile", /cannot be read/],
    [() => connect("localhost:1"), "options", /"localhost:1" must be an object/],
    [() => Video.open("/no/such.mp4"), "video", /no such file/],
    [() => Video.open(scene.camera), "video", /not readable as a video/],
    [() => track(scene.video, { map: "yard", box: [1, 2, 0, 4] }), "box.width", /above 0/],
    [() => track(scene.video, { map: "yard", boxFrame: 3 }), "boxFrame", /missing/],
    [() => track(scene.video, { map: "yard", targets: { "a b": { box: [1, 2, 3, 4] } } }), "targets.a b", /A-Z/],
  ];
  for (const [call, field, words] of cases) {
    await assert.rejects(async () => call(), (error) => {
      assert.ok(error instanceof GroundlockError, `${field}: ${error?.stack}`);
      assert.equal(error.field, field);
      assert.match(error.message, words);
      return true;
    }, field);
  }
  // None of these has cost a sequence number.
  assert.equal(await stream.send({ image: frames[0].image }), 0);
  await stream.cancel();
  await session.delete();
  // The server's words name the field, too.
  await assert.rejects(client.createSession({ map: "nowhere", camera }), code("NOT_FOUND", /nowhere/));
  await assert.rejects(client.createSession({ map: null, camera, options: { tracker: "none" } }), code("INVALID_ARGUMENT", /tracker.*dcf/));
});

// --- connecting ---------------------------------------------------------------

test("nobody answers", async () => {
  await assert.rejects(connect({ server: "127.0.0.1:1", connectTimeoutMs: 300 }), code("UNAVAILABLE", /127.0.0.1:1: .*groundlock-server/));
});

test("tokens and TLS", async () => {
  const path = folder();
  const tokens = join(path, "tokens");
  writeFileSync(tokens, `${TOKEN}\n`, { mode: 0o600 });
  chmodSync(path, 0o700);
  const openssl = (...args) => execFileSync("openssl", args, { cwd: path, stdio: "ignore" });
  const key = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"];
  openssl("req", "-x509", ...key, "-days", "2", "-subj", "/CN=Test CA", "-keyout", "ca.key", "-out", "ca.pem");
  writeFileSync(join(path, "ext"), "subjectAltName=DNS:localhost\n");
  for (const name of ["server", "client"]) {
    openssl("req", ...key, "-subj", `/CN=${name}`, "-keyout", `${name}.key`, "-out", "request");
    openssl("x509", "-req", "-in", "request", "-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial", "-days", "2",
      "-extfile", "ext", "-out", `${name}.pem`);
    chmodSync(join(path, `${name}.key`), 0o600);
  }
  const file = (name) => join(path, name);
  const own = await ownServer(
    "--token-file", tokens, "--tls-cert", file("server.pem"), "--tls-key", file("server.key"),
    "--tls-client-ca", file("ca.pem"), "--tls-require-client-cert");
  const address = `localhost:${own.port}`;
  const tls = { ca: file("ca.pem"), cert: file("client.pem"), key: file("client.key") };
  for (const options of [{ token: TOKEN }, { tokenFile: tokens }]) {
    const known = await connect({ server: address, tls, ...options });
    assert.deepEqual((await known.listMaps()).map((m) => m.name), ["yard"]);
    await within(known, { map: null, camera }, async (session) => {
      assert.deepEqual((await all(session.track(frames.slice(0, 2)))).map((a) => a.kind), ["result", "result"]);
    });
    await known.close();
  }
  const known = await connect({ server: address, tls, token: TOKEN });
  const caller = await known.caller();
  assert.ok(!caller.openToAll && caller.scopes.includes("sessions:own"), JSON.stringify(caller));
  await within(known, { map: null }, async (session) => assert.equal((await session.info()).owner, caller.name));
  await known.close();
  assert.ok((await client.caller()).openToAll);
  const unknown = await connect({ server: `grpcs://127.0.0.1:${own.port}`, tls: { ...tls, serverName: "localhost" } });
  await assert.rejects(unknown.listMaps(), code("UNAUTHENTICATED"));
  await unknown.close();
  for (const wrong of [undefined, { ...tls, ca: file("client.pem") }, { ca: tls.ca }]) {
    await assert.rejects(connect({ server: address, ...(wrong && { tls: wrong }), connectTimeoutMs: 1000 }), code("UNAVAILABLE"));
  }
});

const alive = (pid) => {
  try {
    return readFileSync(`/proc/${pid}/stat`, "utf8").split(")").at(-1).trim()[0] !== "Z";
  } catch {
    return false;
  }
};

test("a server of the program's own ends with it", async () => {
  const data = folder();
  const here = dirname(fileURLToPath(import.meta.url));
  const script = `import { LocalServer } from "groundlock"; const s = await LocalServer.start();
    console.log(s.pid); setInterval(() => {}, 1000);`;
  const program = spawn(process.execPath, ["--input-type=module", "-e", script], {
    cwd: here, env: { ...process.env, XDG_DATA_HOME: data }, stdio: ["ignore", "pipe", "inherit"],
  });
  const [text] = await new Promise((done) => program.stdout.once("data", (d) => done([String(d)])));
  const pid = Number(text);
  assert.ok(alive(pid));
  program.kill("SIGKILL");
  await until("the end of the server", () => !alive(pid));
  await assert.rejects(LocalServer.start({ program: "/no/such" }), code("NOT_FOUND", /program: /));
  await assert.rejects(LocalServer.start({ program: "/bin/false", store: join(data, "s") }), code("UNAVAILABLE", /server.log/));
});

// --- the whole ----------------------------------------------------------------

test("track: the results of the command line", async () => {
  const seen = [];
  const run = await track(scene.video, {
    map: "yard", box: scene.box, camera, last: COUNT, server: server.address, onAnswer: (a) => seen.push(a),
  });
  assert.deepEqual(run.answers, seen);
  assert.equal(run.target().length, COUNT);
  const path = folder();
  assert.equal(run.writeCsv(join(path, "ours.csv")), COUNT);
  execFileSync(join(BIN, "groundlock"), [
    "track", scene.video, "--map", "yard", "--camera", scene.camera, "--init-box", scene.box.join(","),
    "--frames", `0:${COUNT}`, "--results", join(path, "theirs.csv"), "--server", server.address,
  ], { stdio: "ignore" });
  const table = (name) => readFileSync(join(path, name), "utf8").trim().split("\n").map((line) => line.split(","));
  const [ours, theirs] = [table("ours.csv"), table("theirs.csv")];
  assert.deepEqual(ours[0], theirs[0]);
  assert.deepEqual(ours[0], COLUMNS);
  assert.equal(ours.length, theirs.length);
  ours.slice(1).forEach((row, i) => {
    const other = theirs[i + 1];
    assert.deepEqual(row.slice(0, 2), other.slice(0, 2));
    row.forEach((v, k) => assert.equal(v === "", other[k] === "", COLUMNS[k]));
    for (const name of ["cam_x", "cam_y", "cam_z"]) {
      const k = COLUMNS.indexOf(name);
      if (row[k] !== "") assert.ok(Math.abs(row[k] - other[k]) < 0.1, name);
    }
  });
  assert.deepEqual([...rows([{ kind: "dropped", sequence: 7, reason: "overload" }], new Map([[7, 5_000_000n]]))], [{ frame: 7, t_s: 0.005 }]);
});

test("track: the map's lens, images in a folder, no map, a server of its own", async () => {
  const path = folder();
  const ffmpeg = (...args) => execFileSync("ffmpeg", ["-v", "error", "-i", scene.video, ...args]);
  ffmpeg("-frames:v", "3", join(path, "%03d.jpg"));
  const images = await track(path, { map: "yard", fps: 24, client });
  assert.deepEqual([...images.captureTimesNs.values()], [0n, 41666667n, 83333333n]);
  assert.deepEqual(images.session.camera, (await client.getMap("yard")).lens);
  assert.equal(images.results.length, 3);
  const uneven = join(path, "uneven.mkv");
  ffmpeg("-frames:v", "5", "-vf", "scale=160:90,settb=1/1000,setpts=N*N*10", "-fps_mode", "passthrough", "-enc_time_base", "1:1000", uneven);
  const times = (await all(await Video.open(uneven))).map((f) => f.captureTimeNs);
  assert.deepEqual(times, [0n, 10_000_000n, 40_000_000n, 90_000_000n, 160_000_000n]);
  const flat = await track(uneven, { map: null, box: [40, 30, 20, 20], client });
  assert.equal(flat.target().length, 5);
  await assert.rejects(
    track(uneven, { map: null, targets: { far: { box: [9000, 9000, 5, 5] } }, client }),
    (error) => error.field === "targets.far" && code("INVALID_ARGUMENT", /target far: /)(error));
  process.env.XDG_DATA_HOME = folder();
  const local = await connect({ local: true });
  await local.importMap("yard", scene.map, { align: scene.align });
  await local.close();
  // Another program, later: the map is still there.
  assert.equal((await track(scene.video, { map: "yard", box: scene.box, last: 2, local: true })).results.length, 2);
});

test("track: what an inertial unit recorded", async () => {
  const path = folder();
  execFileSync(join(BIN, "groundlock"), [
    "simulate", "yard", "pan", "--size", "320x180", "--samples", "1", "--frames", "6", "--out", path,
  ], { stdio: "ignore" });
  const files = { imu: join(path, "imu.json"), inertial: join(path, "pan_imu.csv") };
  const run = await track(join(path, "pan.mp4"), { map: null, camera: join(path, "camera.json"), ...files, client });
  assert.equal(run.results.length, 6);
  assert.ok(run.results.every((r) => r.camera.ignoresGyroscope === false));
  const imu = readImu(files.imu);
  for (const n of ["w", "x", "y", "z"]) {
    assert.ok(Math.abs(run.session.options.imu.imuFromCamera[n] - imu.imuFromCamera[n]) < 1e-6);
  }
  // Each sample goes with one frame, up to the first that is not before it.
  const samples = readInertial(files.inertial);
  const lines = readFileSync(files.inertial, "utf8").split("\n").filter((line) => line && !line.startsWith("#"));
  assert.deepEqual(samples.map((s) => [`${s.timeNs}`, ...s.angularRateRadS]), lines.map((line) => {
    const [time, ...values] = line.split(",");
    return [time, ...values.slice(0, 3).map(Number)];
  }));
  const dealt = [];
  let previous;
  for (const capture of [0n, 40_000_000n, 90_000_000n, 10n ** 15n]) {
    const own = inertialBetween(samples, previous, capture);
    assert.ok(own.slice(0, -1).every((s) => s.timeNs < capture));
    dealt.push(...own);
    previous = capture;
  }
  assert.deepEqual(dealt, samples);
  const epoch = samples[3].timeNs;
  assert.deepEqual(inertialSince(samples, epoch).map((s) => s.timeNs), samples.slice(3).map((s) => s.timeNs - epoch));
  // The server looks at what comes: it refuses what no unit measures.
  await within(client, { map: null, camera: join(path, "camera.json"), options: { imu } }, async (session) => {
    const image = rawImage("gray8", new Uint8Array(320 * 180), 320, 180);
    const wild = [{ timeNs: 5n, angularRateRadS: [1e300, 0, 0] }];
    const [answer] = await all(session.track([{ image, inertial: wild }]));
    assert.equal(answer.kind, "failed");
    assert.match(answer.error.message, /inertial/);
  });
  const bad = join(path, "bad.csv");
  writeFileSync(bad, "# head\n1,2,x,4,5,6,7\n");
  assert.throws(() => readInertial(bad), code("INVALID_ARGUMENT", /bad.csv: line 2, column 3 \(w_y\): "x" is not a number/));
});

test("recordings: an interrupted one, and damaged ones", async () => {
  // The Python tests record with the real dashboard; here its bytes by hand.
  const path = folder();
  const text = (s) => Buffer.concat([u32(s.length), Buffer.from(s)]);
  const u16 = (v) => { const b = Buffer.alloc(2); b.writeUInt16LE(v); return b; };
  const u32 = (v) => { const b = Buffer.alloc(4); b.writeUInt32LE(v); return b; };
  const u64 = (v) => { const b = Buffer.alloc(8); b.writeBigUInt64LE(BigInt(v)); return b; };
  const record = (op, ...parts) => { const c = Buffer.concat(parts); return Buffer.concat([Buffer.of(op), u64(c.length), c]); };
  const channel = (id, topic) => record(4, u16(id), u16(0), text(topic), text("protobuf"), u32(0));
  const message = (id, bytes) => record(5, u16(id), u32(0), u64(1), u64(2), bytes);
  const inner = Buffer.concat([
    channel(1, "/session/info"), channel(2, "/session/result"),
    message(1, Buffer.from("\x0a\x01s", "latin1")),
    message(2, Buffer.from([0x08, 3, 0x1a, 2, 0x08, 4])), // sequence 3, camera LOST
  ]);
  const chunk = record(6, u64(0), u64(0), u64(inner.length), u32(0), text(""), u64(inner.length), inner);
  const whole = Buffer.concat([Buffer.from("\x89MCAP0\r\n", "latin1"), record(1, text(""), text("x")), chunk]);
  const file = join(path, "a.mcap");
  writeFileSync(file, Buffer.concat([whole, Buffer.of(6, 99)]));
  const recording = await Recording.open(file);
  assert.equal(recording.complete, false);
  assert.equal(recording.session.sessionId, "s");
  assert.equal(recording.map, undefined);
  const results = await all(recording.results());
  assert.deepEqual(results.map((r) => [r.sequence, r.camera.state]), [[3, "LOST"]]);
  await recording.close();
  await assert.rejects(Recording.open(join(path, "none")), code("NOT_FOUND"));
  writeFileSync(file, "GIF89a and more");
  await assert.rejects(Recording.open(file), code("DATA_LOSS", /is no MCAP file/));
  let seed = 7;
  const random = (n) => (seed = (seed * 1103515245 + 12345) % 2147483648) % n;
  const outcomes = { read: 0, refused: 0 };
  for (let i = 0; i < 300; ++i) {
    const bytes = Buffer.from(whole);
    for (let k = 0; k <= random(3); ++k) bytes[8 + random(bytes.length - 8)] = random(256);
    writeFileSync(file, bytes.subarray(0, random(4) ? bytes.length : 20 + random(bytes.length - 20)));
    try {
      const mutant = await Recording.open(file);
      try {
        await all(mutant.results());
        await all(mutant.images());
        await mutant.pointCloud();
        ++outcomes.read;
      } finally {
        await mutant.close();
      }
    } catch (error) {
      assert.ok(error instanceof GroundlockError, String(error?.stack));
      ++outcomes.refused;
    }
  }
  assert.ok(outcomes.read > 0 && outcomes.refused > 50, JSON.stringify(outcomes));
});

test("a recording of the dashboard", async (t) => {
  const file = process.env.GROUNDLOCK_RECORDING;
  if (!file || !existsSync(file)) return t.skip("no recording: $GROUNDLOCK_RECORDING");
  const recording = await Recording.open(file);
  assert.ok(recording.complete);
  assert.ok((await all(recording.results())).length > 0);
  assert.ok((await all(recording.images())).every((i) => i.image.data[0] === 0xff));
  assert.ok((await recording.pointCloud()).xyzWorld.length > 0);
  await recording.close();
});
