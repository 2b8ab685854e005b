// SPDX-License-Identifier: Apache-2.0
// The dashboard as a person uses it: the real page in a real browser, the real
// proxy, the real server, the real command line as the camera.
import assert from "node:assert/strict";
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, beforeEach, describe, it } from "node:test";
import { assertAccessible, assertNoProblems, history, launch, openPage, overlap, screenshot, shown } from "./browser.mjs";
import { countColor, decodePng } from "./png.mjs";
import {
  groundlock, prepareScene, residentBytes, startDashboard, startServer, stop, stopAll, stream, TOKEN, until,
} from "./programs.mjs";
import { StalledViewer } from "./stalled_viewer.mjs";

const TRACKED = 1;
const LOCALIZED = 2;
const YELLOW = [0xf5, 0xcb, 0x45];
const GREEN = [0x35, 0xd0, 0x7f];
const LIGHT = [0xf6, 0xf8, 0xfa]; // the scene's background by day
const PURPLE = [0xb5, 0x7b, 0xff];

const folder = mkdtempSync(join(tmpdir(), "groundlock-browser-"));
let scene, server, dashboard, client, browser, page, url;

// What comes after the log-in is the list of sessions, or the session itself
// if just one is streaming: each test waits for what it looks at.
async function logIn(where) {
  const token = where.getByLabel("Token");
  await token.fill(TOKEN);
  await where.getByRole("button", { name: "Log in" }).click();
  await token.waitFor({ state: "detached" });
}

const frames = (where, count) => where.evaluate(() => window.groundlock.model.player.current.value?.sequence ?? -1)
  .then((from) => until(`${count} frames`, async () => ((await shown(where))?.sequence ?? -1) >= from + count));

// Waits for a moment at which the target is in full view and stays so.
async function targetInView(ahead = 10) {
  return until("the target in view", async () => {
    const now = await shown(page);
    if (!now) return null;
    for (let k = 0; k < 60; k += 10) {
      const t = scene.truthOf(now.sequence + k);
      if (!(t.visible_fraction > 0.95 && t.inframe_fraction > 0.99)) return null;
    }
    return scene.truthOf(now.sequence + ahead);
  });
}

async function dropAll() {
  for (const { id } of (await shown(page)).targets) {
    await page.getByRole("button", { name: `Drop ${id}` }).click();
  }
  await until("no target", async () => (await shown(page))?.targets.length === 0);
}

// Draws a box where the target will be by the time the mouse is up; does so again
// where the events took so long that it had left the box by then.
async function drawAroundTarget() {
  const truthBox = (sequence) => {
    const t = scene.truthOf(sequence);
    return { x: t.box_x, y: t.box_y, width: t.box_w, height: t.box_h };
  };
  return until("a box around the target", async () => {
    const t = await targetInView();
    const rect = await page.locator(".image-clip").boundingBox();
    const scale = rect.width / scene.width;
    await page.keyboard.press("b");
    await page.mouse.move(rect.x + t.vis_x * scale, rect.y + t.vis_y * scale);
    await page.mouse.down();
    await page.mouse.move(rect.x + (t.vis_x + t.vis_w) * scale, rect.y + (t.vis_y + t.vis_h) * scale, { steps: 3 });
    await page.mouse.up();
    const target = await until("a tracked target with a 3D box", async () =>
      (await shown(page))?.targets.find((x) => x.state === TRACKED && x.world));
    const first = (await history(page, target.id)).find(({ box }) => box);
    if (overlap(first.box, truthBox(first.sequence)) > 0.5) return target;
    await page.getByRole("button", { name: `Drop ${target.id}` }).click();
    await until("no target", async () => (await shown(page))?.targets.length === 0);
    return null;
  });
}

async function pixels(selector, color) {
  return countColor(decodePng(await page.locator(selector).screenshot()), color);
}

// Stands still at the newest frame of the last seconds that is like this one;
// until there is one. Live frames go on, and a slow machine loses the camera
// now and then: what is looked at here must not depend on when one looks.
async function standStillAt(what, wanted) {
  // As text: the page's policy allows it no eval().
  await until(what, () => page.evaluate(`(() => {
    const wanted = ${wanted};
    const { history } = window.groundlock.model.player;
    for (let i = history.length - 1; i >= Math.max(0, history.length - 200); --i) {
      const record = history.at(i);
      if (!history.images.get(record.sequence) || !wanted(record)) continue;
      window.groundlock.jump(record.timeS);
      return true;
    }
    return false;
  })()`));
  await until("it shown", () => page.evaluate(() => {
    const { cursor, current } = window.groundlock.model.player;
    return current.value && Math.abs(current.value.timeS - cursor.value) < 1e-6;
  }));
}

describe("dashboard", { timeout: 2_300_000 }, () => {
  before(async () => {
    scene = prepareScene();
    server = await startServer(folder);
    groundlock(folder, server.port, "map", "import", "yard", scene.map, "--align", scene.align);
    dashboard = await startDashboard(folder, server.port, scene.sources);
    url = `http://127.0.0.1:${dashboard.port}/`;
    browser = await launch();
    page = await openPage(browser);
    page.expected.push(/status of 401/); // the wrong token below
  });

  // Each begins where a failed one would not have ended.
  beforeEach(async () => {
    const kind = await page?.evaluate(() => window.groundlock?.model.view.value?.kind).catch(() => null);
    if (!kind) return;
    await page.evaluate((replaying) => {
      if (replaying) location.hash = "#/session/drive";
      window.groundlock.dialog.value = null;
      window.groundlock.setMode("look");
      window.groundlock.goLive();
    }, kind === "replay");
  });

  after(async () => {
    await browser?.close();
    await stopAll();
    rmSync(folder, { recursive: true, force: true });
  });

  it("asks for the token", async () => {
    await page.goto(url);
    await page.getByLabel("Token").fill("wrong");
    await assertAccessible(page, "log-in");
    await page.getByRole("button", { name: "Log in" }).click();
    await page.getByText("does not know this token").waitFor();
    await logIn(page);
    await page.getByText("No session is open").waitFor();
    await assertAccessible(page, "start page");
  });

  it("shows a session that a client streams", async () => {
    client = stream(folder, server.port, scene, "drive");
    await page.getByRole("button", { name: /drive/ }).first().click();
    await until("a localised camera with landmarks", async () => {
      const now = await shown(page);
      return now?.cameraState === LOCALIZED && now.matches > 20 && now.images > 5;
    });
    await until("the map's points", () => page.evaluate(() => (window.groundlock.model.cloud.value?.positions.length ?? -1) >= 0));
    await standStillAt("a frame with landmarks", (r) => r.result.camera?.state === 2 && r.result.camera.matchXyPx.length > 20);
    await until("purple landmarks", async () => (await pixels(".image-pane", PURPLE)) > 30);
    await page.evaluate(() => window.groundlock.goLive());
    await assertAccessible(page, "session");
  });

  it("makes what moves a target by a click", async () => {
    const isCar = ({ sequence, box }) => {
      const t = scene.truthOf(sequence);
      return t.box_w > 0 && overlap(box, { x: t.box_x, y: t.box_y, width: t.box_w, height: t.box_h }) > 0.2;
    };
    await until("a target that was a mover", async () => {
      const mover = await page.evaluate(() => {
        const record = window.groundlock.model.player.current.value;
        const box = record?.result.movers[0]?.box;
        return box ? { sequence: record.sequence, box: { x: box.x, y: box.y, width: box.width, height: box.height } } : null;
      });
      if (!mover || !isCar(mover)) return null;
      const rect = await page.locator(".image-clip").boundingBox();
      const scale = rect.width / scene.width;
      await page.mouse.click(
        rect.x + (mover.box.x + 0.5 * mover.box.width) * scale, rect.y + (mover.box.y + 0.5 * mover.box.height) * scale);
      // A busy machine shows what is past: the click may have missed, or the
      // car have left the box by the time that the server has it.
      await frames(page, 5);
      const [target] = (await shown(page)).targets;
      if (!target) return false;
      const first = (await history(page, target.id)).find(({ box }) => box);
      if (first && isCar(first)) return true;
      await dropAll();
      return false;
    });
    await dropAll();
    // The same by its button, in words. What moved may stand, or be out of view,
    // by the time of the click: the page says so, and one clicks the next. In one
    // step, as on a busy machine no button stands still for long.
    await until("a target by the button", async () => {
      const clicked = await page.evaluate(() => {
        const button = document.querySelector('button[aria-label^="Make mover "]');
        button?.click();
        return !!button;
      });
      if (!clicked) return false;
      await frames(page, 5);
      return (await shown(page)).targets.length > 0;
    });
    await dropAll();
  });

  it("tracks what a box is drawn around", async () => {
    const target = await drawAroundTarget();
    // In messages: where the rendered truth has it, over more than a second.
    const first = (await shown(page)).sequence;
    await frames(page, 30);
    const boxes = await history(page, target.id);
    const values = boxes
      .filter(({ sequence, box }) => sequence >= first && box)
      .map(({ sequence, box }) => ({ box, truth: scene.truthOf(sequence) }))
      .filter(({ truth }) => truth.box_w && truth.seen_fraction > 0.9)
      .map(({ box, truth: t }) => overlap(box, { x: t.box_x, y: t.box_y, width: t.box_w, height: t.box_h }))
      .sort((a, b) => a - b);
    assert.ok(values.length > 0, "the target went out of view at once");
    assert.ok(values[values.length >> 1] > 0.3, `median overlap ${values[values.length >> 1]}`);
    // In pixels: on the image and in the scene, at a frame that has it.
    await standStillAt("a localised frame with the target seen", (r) =>
      r.result.camera?.state === 2 && r.result.targets.some((t) => t.state === 1 && t.boxWorld));
    await until("the 3D box on the image", async () => (await pixels(".image-pane", YELLOW)) > 60);
    await until("its front face on the image", async () => (await pixels(".image-pane", GREEN)) > 30);
    await until("the box in the scene", async () => (await pixels(".scene-view", GREEN)) > 3);
    await page.getByRole("article", { name: `Target ${target.id}` }).waitFor();
    await page.evaluate(() => window.groundlock.goLive());
    await frames(page, 60);
    await screenshot(page, "dashboard_dark");
  });

  it("marks a target of the kind that was chosen", async () => {
    await dropAll();
    await page.keyboard.press("b");
    const kinds = page.getByLabel("Kind of target");
    await kinds.selectOption({ label: "car" });
    await screenshot(page, "dashboard_kind");
    await page.keyboard.press("Escape");
    assert.equal(await kinds.count(), 0, "the choice stays after drawing");
    const target = await drawAroundTarget();
    const card = page.getByRole("article", { name: `Target ${target.id}` });
    await card.getByText("car", { exact: true }).waitFor();
    await screenshot(page, "dashboard_kind_card");
    await page.keyboard.press("b");
    await kinds.selectOption({ label: "of any kind" });
    await page.keyboard.press("Escape");
  });

  it("tells the delay from capture to the page", async () => {
    await page.evaluate(() => window.groundlock.latency.clear());
    await frames(page, 120);
    const { fromCapture, median, count } = await page.evaluate(() => {
      const samples = [...window.groundlock.latency.recent].sort((a, b) => a - b);
      return { fromCapture: window.groundlock.latency.fromCapture.value, median: samples[samples.length >> 1], count: samples.length };
    });
    assert.ok(fromCapture, "the capture times are not on the dashboard's clock");
    assert.ok(count > 0);
    console.log(`# capture to drawn: median ${median.toFixed(0)} ms of ${count} frames drawn out of 120`);
  });

  it("keeps the stabilised view and all views alive", async () => {
    await page.keyboard.press("v");
    await page.keyboard.press("u");
    await until("a warped image", () =>
      page.locator(".image-canvas").evaluate((e) => e.style.transform.startsWith("matrix3d(")));
    await page.keyboard.press("c");
    await page.keyboard.press("t");
    await until("the scene in light colours", async () => (await pixels(".scene-view", LIGHT)) > 2000);
    await frames(page, 24);
    await screenshot(page, "dashboard_light");
    await assertAccessible(page, "session, light");
    for (const key of ["t", "o", "v"]) await page.keyboard.press(key);
    await page.keyboard.press("?");
    await page.getByRole("dialog", { name: "Keys and colours" }).waitFor();
    await assertAccessible(page, "help");
    await page.keyboard.press("Escape");
  });

  it("goes back in time and forward to now", async () => {
    await page.getByRole("slider", { name: "Position in time" }).focus();
    for (let i = 0; i < 5; ++i) await page.keyboard.press("ArrowLeft");
    const past = await until("the past", async () => {
      const [now, wanted] = await page.evaluate(() => {
        const { player } = window.groundlock.model;
        const { cursor, history, current } = player;
        return [current.value?.sequence, cursor.value === null ? null : history.at(history.indexAt(cursor.value + 1e-6))?.sequence];
      });
      return now === wanted ? shown(page) : null;
    });
    await new Promise((resolve) => setTimeout(resolve, 300));
    assert.equal((await shown(page)).sequence, past.sequence, "the past moved");
    await page.getByRole("button", { name: "Live" }).click();
    await until("now", async () => (await shown(page)).sequence > past.sequence + 5);
  });

  it("is not held back by a viewer that takes nothing", async () => {
    const cookies = await page.context().cookies();
    const stalled = new StalledViewer(dashboard.port, cookies.map((c) => `${c.name}=${c.value}`).join("; "));
    await stalled.subscribe("drive");
    const before = residentBytes(dashboard);
    const from = (await shown(page)).sequence;
    const other = await openPage(browser);
    await other.goto(url);
    await logIn(other);
    await other.evaluate(() => (location.hash = "#/session/drive"));
    await until("frames for another viewer", async () => ((await shown(other))?.images ?? 0) > 10);
    await frames(page, 72);
    // A busy machine shows few of them.
    await until("results for the other viewer", async () =>
      (await history(other)).filter(({ sequence }) => sequence > from).length > 20);
    await frames(page, 10);
    // Of the frames since then, this page has what the other one has, too: what
    // the server itself left out on a busy machine nobody has.
    const [ours, theirs] = await Promise.all([history(page), history(other)]);
    const common = theirs.filter(({ sequence }) => sequence > from && sequence <= ours[ours.length - 1].sequence);
    const have = new Set(ours.map(({ sequence }) => sequence));
    assert.ok(common.length > 20, `the other viewer has ${common.length} results`);
    assert.deepEqual(common.filter(({ sequence }) => !have.has(sequence)), [], "results are missing");
    const grown = residentBytes(dashboard) - before;
    console.log(`# a stalled viewer: the dashboard grew by ${(grown / 2 ** 20).toFixed(1)} MiB in 72 frames`);
    assert.ok(grown < 64 * 2 ** 20, `the dashboard grew by ${grown} bytes`);
    stalled.close();
    assertNoProblems(other);
    await other.context().close();
  });

  it("records, and replays what it recorded", async () => {
    await page.keyboard.press("r");
    await page.getByRole("button", { name: "End the recording" }).waitFor();
    const begun = (await shown(page)).sequence;
    // Frames that came, however many the server left out on a busy machine.
    await until("results to record", async () =>
      (await history(page)).filter(({ sequence }) => sequence > begun).length > 40);
    // And until a frame has been recorded in which the target has its 3D box.
    await until("the target in its 3D box", async () =>
      (await history(page)).some(({ sequence, world }) => sequence > begun + 5 && world));
    await page.getByRole("button", { name: "End the recording" }).click();
    const told = await page.getByText(/^Recorded /).textContent();
    const recorded = Number(/: (\d+) frames/.exec(told)[1]);
    assert.ok(recorded > 10, told);
    await page.keyboard.press("s");
    await assertAccessible(page, "sessions");
    await page.getByRole("dialog").getByRole("button", { name: /frames · .*B/ }).first().click();
    await until("the whole recording", async () => ((await shown(page))?.frames ?? 0) === recorded);
    await until("its images", async () => (await shown(page)).images > 0);
    const first = await shown(page);
    const all = await history(page);
    assert.equal(first.sequence, all[0].sequence, "it does not begin at its beginning");
    await page.keyboard.press("End");
    const last = await until("the end", async () => {
      const now = await shown(page);
      return now.sequence === all[recorded - 1].sequence ? now : null;
    });
    // Some frame has the target with its 3D box; at it the page shows it.
    const boxed = all.find(({ world }) => world);
    assert.ok(boxed, "the target is not in the recording");
    await page.evaluate((t) => window.groundlock.jump(t), boxed.timeS);
    const there = await until("that frame", async () => {
      const now = await shown(page);
      return now.sequence === boxed.sequence ? now : null;
    });
    assert.ok(there.targets.some((x) => x.world), "the target is not shown there");
    const slider = page.getByRole("slider", { name: "Position in time" });
    const box = await slider.boundingBox();
    await page.mouse.click(box.x + 0.5 * box.width, box.y + 5);
    await until("the middle", async () => {
      const s = (await shown(page)).sequence;
      return s > first.sequence && s < last.sequence;
    });
    await page.keyboard.press(" ");
    await until("it playing", async () => (await shown(page)).sequence >= last.sequence - 1);
    await screenshot(page, "dashboard_replay");
    await page.goBack();
    await until("the session", async () => ((await shown(page))?.sequence ?? 0) > last.sequence);
  });

  it("exports trajectories", async () => {
    await page.keyboard.press("e");
    await assertAccessible(page, "export");
    const download = page.waitForEvent("download");
    await page.getByRole("button", { name: "Export", exact: true }).click();
    assert.equal((await download).suggestedFilename(), "drive.csv");
  });

  it("sets the map's ground by three places and level through one", async () => {
    const before = JSON.parse(groundlock(folder, server.port, "map", "show", "yard", "--json"));
    await page.keyboard.press("u");
    await page.keyboard.press("g");
    const panel = page.getByRole("group", { name: "The map's ground" });
    await panel.getByText("(0 of 3)").waitFor();
    assert.ok(await panel.getByRole("button", { name: "Set the ground" }).isDisabled());
    await assertAccessible(page, "setting the ground");
    // Somewhere there are points of the map.
    const box = await page.locator(".scene-view canvas").boundingBox();
    const places = () => page.evaluate(() => window.groundlock.ground.places.value.length);
    for (const [x, y] of [[0.4, 0.45], [0.6, 0.4], [0.5, 0.65], [0.35, 0.6], [0.65, 0.6], [0.5, 0.5], [0.45, 0.35], [0.55, 0.7]]) {
      if ((await places()) === 3) break;
      await page.mouse.click(box.x + x * box.width, box.y + y * box.height);
    }
    assert.equal(await places(), 3, "there are no points where one clicks");
    await panel.getByText(/Through these three places|on a line/).waitFor();
    await screenshot(page, "dashboard_ground");
    await panel.getByRole("button", { name: "Level here" }).click();
    await panel.getByText("Level through this place").waitFor();
    const asked = await page.evaluate(() => window.groundlock.ground.plane.value);
    // The yard's cameras were held level, in a world whose z is up.
    assert.ok(asked.normal[2] > 0.995, JSON.stringify(asked));
    await panel.getByRole("button", { name: "Set the ground" }).click();
    await page.getByText(`from version ${before.version + 1} on`).waitFor();
    const after = JSON.parse(groundlock(folder, server.port, "map", "show", "yard", "--json"));
    assert.equal(after.version, before.version + 1);
    assert.equal(after.ground.state, "measured");
    // The world has turned and moved so that this plane is z = 0.
    const rotate = ([w, x, y, z], v) => {
      const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
      const t = cross([x, y, z], v).map((c) => 2 * c);
      return v.map((c, i) => c + w * t[i] + cross([x, y, z], t)[i]);
    };
    const back = before.world_from_source.rotation_wxyz.map((c, i) => (i === 0 ? c : -c));
    const up = rotate(after.world_from_source.rotation_wxyz, rotate(back, asked.normal));
    assert.ok(up[2] > 1 - 1e-9, JSON.stringify([before.world_from_source, after.world_from_source, asked]));
    // Places of this session's version say nothing about the new one.
    await page.keyboard.press("g");
    await page.getByText("has a newer version").waitFor();
    await page.keyboard.press("o");
  });

  it("takes a map", async () => {
    await page.keyboard.press("p");
    await page.getByRole("button", { name: "Upload or build" }).click();
    await page.getByLabel("Name").fill("again");
    await page.getByLabel("Folder").setInputFiles(scene.map);
    await page.getByLabel("align.json").setInputFiles(scene.align);
    await page.getByRole("button", { name: "Upload", exact: true }).click();
    await page.getByRole("heading", { name: /^again/ }).waitFor();
    await page.getByRole("button", { name: "Check" }).click();
    await page.getByText("The map is sound.").waitFor();
    await assertAccessible(page, "maps");
    await screenshot(page, "dashboard_maps");
    await page.keyboard.press("Escape");
    assert.match(groundlock(folder, server.port, "map", "list"), /again/);
  });

  it("aligns a map by control points", async () => {
    // Twice as large, and moved.
    const positions = [[0, 0, 0], [4, 0, 0.5], [0, 5, 1], [3, 3, 0], [-4, 2, 0.3], [1, -4, 2]];
    const points = positions.map(([x, y, z], i) => (
      { name: `corner ${i + 1}`, position: [x, y, z], place: [2 * x + 10, 2 * y - 20, 2 * z + 5] }));
    // One of them was measured wrongly.
    const blunder = points.map((p, i) => (i === 3 ? { ...p, place: p.place.map((v) => v + 3) } : p));
    const errorOf = async (name) =>
      Number(await page.getByRole("row", { name }).getByRole("cell").first().textContent());
    const choose = (list) => page.getByLabel("Control points", { exact: true }).setInputFiles({
      name: "points.json", mimeType: "application/json", buffer: Buffer.from(JSON.stringify({ points: list })),
    });
    const before = JSON.parse(groundlock(folder, server.port, "map", "show", "again", "--json"));
    await page.keyboard.press("p");
    await page.getByRole("button", { name: /^again/ }).click();
    await page.getByRole("button", { name: "Align", exact: true }).click();
    await page.getByRole("button", { name: "Control points" }).click();
    await choose(points.slice(0, 2));
    await page.getByRole("alert").filter({ hasText: "at least 3" }).waitFor();
    await choose(blunder);
    await page.getByRole("button", { name: "Try" }).click();
    await page.getByRole("rowheader", { name: "corner 4" }).waitFor();
    assert.equal(await page.locator(".residuals tbody tr").count(), points.length);
    assert.ok(await errorOf("corner 4") > 1, "the point that was measured wrongly does not stand out");
    await choose(points);
    await page.getByRole("button", { name: "Try" }).click();
    await page.getByText("Fits to 0.000 m").waitFor();
    assert.equal(await errorOf("corner 4"), 0);
    await assertAccessible(page, "aligning a map");
    await screenshot(page, "dashboard_align");
    await page.getByRole("button", { name: "Align", exact: true }).click();
    await page.getByText(`Map again is aligned: version ${before.version + 1}.`).waitFor();
    const after = JSON.parse(groundlock(folder, server.port, "map", "show", "again", "--json"));
    assert.equal(after.version, before.version + 1);
    const scale = (map) => map.world_from_source.scale;
    assert.ok(Math.abs(scale(after) / scale(before) - 2) < 1e-3, JSON.stringify(after.world_from_source));
    await page.keyboard.press("Escape");
  });

  it("starts a session from a source", async () => {
    await page.keyboard.press("n");
    await assertAccessible(page, "new session");
    await page.getByRole("radio", { name: /drive/ }).check();
    await page.getByRole("button", { name: "Start", exact: true }).click();
    await until("its frames", async () => !page.url().endsWith("/drive") && ((await shown(page))?.images ?? 0) > 5);
    await page.getByRole("button", { name: "Pause the source" }).click();
    await page.getByRole("button", { name: "Let the source run" }).waitFor();
    await page.evaluate(() => (location.hash = "#/session/drive"));
    await frames(page, 5);
  });

  it("sees the server go and come back", async () => {
    const { port } = server;
    const lastBefore = (await shown(page)).sequence;
    await stop(server, "SIGKILL");
    await page.getByRole("alert").filter({ hasText: "does not answer" }).waitFor();
    await screenshot(page, "dashboard_unreachable");
    await stop(client);
    server = await startServer(folder, port);
    await page.getByText("The Groundlock server is back.").waitFor();
    client = stream(folder, server.port, scene, "drive");
    // Of the new session: its frames are numbered anew.
    await until("frames", async () => {
      const now = await shown(page);
      return now && now.sequence < lastBefore && now.images > 3;
    });
    await frames(page, 10);
  });

  it("had no errors", () => assertNoProblems(page));
});
