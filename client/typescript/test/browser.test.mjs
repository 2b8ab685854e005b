// SPDX-License-Identifier: Apache-2.0
// The client for browsers in Debian's Chromium: a page of its own, bundled as
// anybody would, served by the real dashboard, which talks to the real server.
import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { once } from "node:events";
import { cpSync, existsSync, mkdirSync, openSync, readFileSync, readdirSync, rmSync, statSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { join } from "node:path";
import { after, before, describe, test } from "node:test";
import { connect, readAlignment, readCamera, Video } from "groundlock";
import { BIN, Server, folder, lastingPort, scene, until } from "./support.mjs";

const TOKEN = "a-token-of-the-browser-test";
const web = process.env.GROUNDLOCK_WEB_MODULES;
const chromium = process.env.CHROMIUM;
const missing = !chromium ? "chromium is not installed"
  : !(web && existsSync(join(web, "node_modules", "playwright-core"))) ? "playwright-core is not installed"
    : !existsSync(join(BIN, "groundlock-dashboard")) ? "groundlock-dashboard is not built" : false;

describe("in a browser", { skip: missing }, () => {
  const place = missing ? "" : folder();
  let server, dashboard, dashboardPort, browser, page, node;

  async function startDashboard() {
    const portFile = join(place, "dashboard.port");
    rmSync(portFile, { force: true });
    const log = openSync(join(place, "dashboard.log"), "a");
    dashboard = spawn(join(BIN, "groundlock-dashboard"), [
      "--listen", `127.0.0.1:${dashboardPort}`, "--server", server.address, "--port-file", portFile,
      "--web", join(place, "web"), "--data", join(place, "dashboard"), "--sources", join(place, "sources"),
      "--token-file", join(place, "tokens"),
    ], { stdio: ["ignore", log, log] });
    dashboard.exited = once(dashboard, "exit");
    await until("the dashboard", () => {
      if (dashboard.exitCode !== null) throw new Error(readFileSync(join(place, "dashboard.log"), "utf8"));
      return existsSync(portFile) && readFileSync(portFile, "utf8").trim();
    });
  }

  before(async () => {
    mkdirSync(join(place, "web"));
    mkdirSync(join(place, "sources"));
    const of = createRequire(join(web, "package.json"));
    // What a page imports, as its bundler finds it: nothing of Node may be in it.
    writeFileSync(join(place, "entry.mjs"), 'export * from "groundlock/browser";\n');
    await of("esbuild").build({
      entryPoints: [join(place, "entry.mjs")], outfile: join(place, "web", "app.js"), bundle: true, format: "iife",
      globalName: "groundlock", platform: "browser", nodePaths: [join(import.meta.dirname ?? process.cwd(), "node_modules")],
      absWorkingDir: process.cwd(), logLevel: "error",
    });
    writeFileSync(join(place, "web", "index.html"),
      '<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,"><script src="/app.js"></script>');
    // What a person would pick from a disk.
    cpSync(scene.map, join(place, "web", "map"), { recursive: true, dereference: true });
    cpSync(scene.video, join(place, "web", "drive.mp4"));
    writeFileSync(join(place, "tokens"), `${TOKEN}\n`, { mode: 0o600 });
    server = await Server.start(place, "--token-file", join(place, "tokens"));
    node = await connect({ server: server.address, token: TOKEN });
    await node.importMap("yard", scene.map, { align: scene.align });
    dashboardPort = await lastingPort();
    await startDashboard();
    browser = await of("playwright-core").chromium.launch({
      executablePath: chromium,
      args: ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"],
    });
    page = await (await browser.newContext()).newPage();
    page.setDefaultTimeout(240_000);
    await page.goto(`http://127.0.0.1:${dashboardPort}/`);
  });
  after(async () => {
    await browser?.close();
    if (dashboard && dashboard.exitCode === null && dashboard.signalCode === null) {
      dashboard.kill("SIGTERM");
      await dashboard.exited;
    }
    node?.close();
    await Server.stopAll();
  });

  // Frames of the scene, forth and back, at the pace at which they are answered.
  async function feed(session, stopped) {
    const images = [];
    for await (const frame of await Video.open(scene.video, { last: 6 })) images.push(frame.image);
    const stream = await session.stream();
    let time = 0n;
    async function* frames() {
      for (let i = 0; !stopped.now; ++i) {
        const k = i % (2 * images.length);
        yield { image: images[k < images.length ? k : 2 * images.length - 1 - k], captureTimeNs: time };
        time += 40_000_000n;
        await new Promise((resolve) => setTimeout(resolve, 40));
      }
    }
    for await (const answer of stream.process(frames())) void answer;
  }

  test("a wrong token, and a dashboard that is not there, are told apart", async () => {
    const told = await page.evaluate(async (gone) => {
      const of = async (options) => {
        try {
          (await groundlock.Dashboard.connect(options)).close();
          return null;
        } catch (error) {
          return { code: error.codeName, field: error.field, message: error.message };
        }
      };
      return [await of({ token: "wrong" }), await of({ url: gone, connectTimeoutMs: 2_000 }), await of({ url: "nonsense" }), await of({ token: "" })];
    }, "http://127.0.0.1:9");
    assert.equal(told[0].field, "token");
    assert.equal(told[0].code, "UNAUTHENTICATED");
    assert.equal(told[1].code, "UNAVAILABLE");
    assert.equal(told[2].field, "url");
    assert.equal(told[3].field, "token");
  });

  test("results and images come, and go on when the dashboard was killed", async () => {
    const session = await node.createSession({ map: "yard", camera: scene.camera, sessionId: "watched" });
    await session.setTarget("car", scene.box, { sequence: 0 });
    const stopped = { now: false };
    const feeding = feed(session, stopped);
    try {
      await page.evaluate(async (token) => {
        window.client = await groundlock.Dashboard.connect({ token });
        window.seen = [];
        window.watching = (async () => {
          for await (const update of client.watch("watched", { images: true })) {
            const car = update.result.targets.find((target) => target.targetId === "car");
            let size = null;
            if (update.image) {
              const bitmap = await createImageBitmap(new Blob([update.image.data]));
              size = [bitmap.width, bitmap.height];
            }
            seen.push({ sequence: update.result.sequence, camera: update.result.camera.state, state: car?.state,
              box: car?.box, ground: car?.groundCenterM && [...car.groundCenterM], size });
          }
          return "ended";
        })().catch((error) => error.message);
      }, TOKEN);
      const seen = () => page.evaluate(() => seen);
      const tracked = await until("a lock in the page", async () => {
        const all = await seen();
        return all.filter((s) => s.state === "TRACKED" && s.camera === "TRACKED" && s.size).length >= 3 && all;
      }, 240);
      assert.deepEqual(tracked.map((s) => s.sequence), tracked.map((s) => s.sequence).sort((a, b) => a - b));
      const one = tracked.find((s) => s.state === "TRACKED" && s.camera === "TRACKED");
      const { width, height } = JSON.parse(readFileSync(scene.camera, "utf8"));
      assert.deepEqual(tracked.find((s) => s.size).size, [width, height]);
      assert.ok(Math.hypot(one.box.x - scene.box[0], one.box.y - scene.box[1]) < 0.3 * scene.box[2], JSON.stringify(one));
      assert.equal(one.ground.length, 3);

      dashboard.kill("SIGKILL");
      await dashboard.exited;
      await startDashboard();
      // The log-in was the dead one's: the page logs in anew, as a person would.
      await until("the page to be back", () => page.evaluate(async (token) => {
        try {
          const answer = await fetch("/api/login", { method: "POST",
            headers: { "Content-Type": "application/json" }, body: JSON.stringify({ token }) });
          return answer.ok;
        } catch { return false; }
      }, TOKEN));
      const before = (await seen()).length;
      await until("results after it", async () => (await seen()).length >= before + 3, 240);
      assert.ok((await page.evaluate(() => client.numReconnects)) >= 1);
    } finally {
      stopped.now = true;
      await feeding;
    }
    await page.evaluate(() => client.deleteSession("watched"));
    assert.equal(await page.evaluate(() => watching), "ended");
  });

  test("maps, points and sessions; bad arguments name the field", async () => {
    const told = await page.evaluate(async () => {
      const cloud = await client.pointCloud("yard");
      const wrong = [];
      for (const call of [
        () => client.setTarget("s", "car", [1, 2, 0, 4]),
        () => client.setTarget("s", "a b", [1, 2, 3, 4]),
        () => client.moveTarget("", "car", [1, 2, 3, 4]),
        () => client.control("s", "plya"),
        () => client.pointCloud("-yard"),
        () => client.start({ map: "yard", sourceId: "" }),
        () => client.start({ map: "yard", sourceId: "x", camera: "camera.json" }),
        () => client.start({ map: "yard", sourceId: "x", targets: { car: [1, 2, 3] } }),
        () => client.watch("a b").next(),
        // The server's own words.
        () => client.moveTarget("nobody", "car", [1, 2, 3, 4]),
        () => client.start({ map: "yard", sourceId: "nowhere" }),
      ]) {
        try {
          await call();
          wrong.push("taken");
        } catch (error) {
          wrong.push([error.codeName, error.field ?? "", error.message]);
        }
      }
      return { maps: client.maps.map((map) => map.name), points: cloud.xyzWorld.length, colours: cloud.rgb.length, wrong };
    });
    assert.deepEqual(told.maps, ["yard"]);
    assert.ok(told.points > 300 && told.points === told.colours);
    const fields = ["box.width", "targetId", "sessionId", "action", "name", "sourceId", "camera.json", "targets.car", "sessionId"];
    told.wrong.slice(0, fields.length).forEach(([code, field, message], i) => {
      assert.equal(code, "INVALID_ARGUMENT", message);
      assert.equal(field, fields[i], message);
      assert.ok(message.startsWith(field), message);
    });
    const [moved, started] = told.wrong.slice(fields.length);
    assert.equal(moved[0], "NOT_FOUND", moved[2]);
    assert.match(moved[2], /nobody/);
    assert.match(started[2], /nowhere|source/);
  });

  test("maps of the page's files and a video of its own; what is wrong names the field", async () => {
    const files = readdirSync(scene.map, { recursive: true }).map(String)
      .filter((path) => statSync(join(scene.map, path)).isFile());
    const told = await page.evaluate(async ({ files, align, camera, box }) => {
      const blob = async (path) => (await fetch(`/${path}`)).blob();
      const picked = await Promise.all(files.map(async (path) => ({ path, data: await blob(`map/${path}`) })));
      const film = await blob("drive.mp4");
      const failure = async (call) => {
        try {
          await call();
          return ["taken", "", ""];
        } catch (error) {
          return [error.codeName ?? error.message, error.field ?? "", error.message];
        }
      };
      const progress = [];
      const imported = await client.importMap("mine", picked, { align, onProgress: (now) => progress.push(now) });
      const twice = { scale: 2, rotation: { w: 1, x: 0, y: 0, z: 0 }, translation: [0, 0, 0] };
      const aligned = await client.alignMap("mine", { newWorldFromWorld: twice });
      const source = await client.uploadVideo("drive.mp4", film);
      const session = await client.start({ map: "mine", camera, sourceId: source.sourceId, loop: true, targets: { car: box } });
      let locked = 0;
      for await (const { result } of client.watch(session.sessionId)) {
        locked += result.camera.state === "TRACKED" && result.targets[0]?.state === "TRACKED" ? 1 : 0;
        if (locked === 3) break;
      }
      await client.deleteSession(session.sessionId);
      const stages = new Set();
      const stopper = new AbortController();
      // Before the one that is cancelled: the server builds one map at a time.
      const wrong = {
        noVideo: await failure(() => client.buildMap("film", [{ path: "drive.mp4", data: new Blob(["no video"]) }])),
        thrown: await failure(() => client.buildMap("film", [{ path: "drive.mp4", data: film }], {
          onProgress: ({ stage }) => {
            stages.add(stage);
            if (stage !== "uploading") throw new Error("that will do");
          },
        })),
        aborted: await failure(() => client.importMap("never", picked, { signal: (stopper.abort(), stopper.signal) })),
        files: await failure(() => client.importMap("mine", [])),
        "files[0]": await failure(() => client.buildMap("film", [{ path: "drive.mp4" }])),
        "files[1]": await failure(() => client.importMap("mine", [...picked.slice(0, 1), { path: "../map", data: film }])),
        name: await failure(() => client.importMap("-mine", picked)),
        origin: await failure(() => client.importMap("mine", picked, { origin: { latitudeDeg: 1, longitudeDeg: 2, heightM: 3 } })),
        format: await failure(() => client.importMap("mine", picked, { format: "colmpa" })),
        maxImages: await failure(() => client.buildMap("film", picked, { maxImages: -1 })),
        video: await failure(() => client.uploadVideo("drive.mp4", "drive.mp4")),
        "knownDistance.from": await failure(() => client.alignMap("mine", { knownDistance: { from: {}, to: {}, distanceM: 1 } })),
      };
      await client.deleteMap("mine");
      return { progress, imported, aligned, locked, stages: [...stages], wrong };
    }, { files, align: readAlignment(scene.align), camera: readCamera(scene.camera), box: scene.box });
    assert.ok(told.imported.map.numLandmarks > 300);
    assert.equal(told.aligned.map.version, 2);
    const sent = told.progress.filter((now) => now.stage === "uploading");
    assert.ok(sent.length > 0 && sent.at(-1).bytesDone === sent.at(-1).bytesTotal, JSON.stringify(sent.at(-1)));
    assert.equal(told.locked, 3);
    const { thrown, aborted, noVideo, ...fields } = told.wrong;
    assert.equal(thrown[0], "that will do");
    assert.ok(told.stages.length >= 2, told.stages.join());
    assert.equal(aborted[0], "CANCELLED");
    assert.notEqual(noVideo[0], "taken");
    assert.match(noVideo[2], /drive\.mp4|video/);
    for (const [field, [code, named, message]] of Object.entries(fields)) {
      assert.equal(code, "INVALID_ARGUMENT", `${field}: ${message}`);
      assert.equal(named, field, message);
    }
    await until("the map to be gone", () => page.evaluate(() => !client.maps.some((map) => map.name === "mine")));
    assert.deepEqual((await node.listMaps()).map((map) => map.name), ["yard"]);
  });
});
