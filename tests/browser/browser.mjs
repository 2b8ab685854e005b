// SPDX-License-Identifier: Apache-2.0
// Debian's Chromium, and what the tests ask of a page.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { join } from "node:path";

const web = createRequire(new URL("../../client/dashboard/web/package.json", import.meta.url));
const { chromium } = web("playwright-core");
const axeSource = readFileSync(web.resolve("axe-core/axe.min.js"), "utf8");

export function launch() {
  return chromium.launch({
    executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
    args: [
      "--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run",
      "--disable-background-networking", "--disable-component-update", "--disable-sync",
    ],
  });
}

// A page of its own context whose errors are collected.
export async function openPage(browser, options = {}) {
  const context = await browser.newContext({
    viewport: { width: 1280, height: 800 }, colorScheme: "dark", reducedMotion: "reduce", ...options,
  });
  const page = await context.newPage();
  page.setDefaultTimeout(240_000); // nothing here is about speed
  page.problems = [];
  page.expected = []; // patterns of errors that a test brings about
  page.on("console", (m) => {
    if (m.type() === "error") page.problems.push(`${m.text()} (${m.location().url})`);
  });
  page.on("pageerror", (error) => page.problems.push(`${error.stack}`));
  return page;
}

export function assertNoProblems(page) {
  const left = page.problems.filter((p) => !page.expected.some((e) => e.test(p)));
  assert.deepEqual(left, []);
}

// No finding of axe that is serious or worse.
export async function assertAccessible(page, where) {
  await page.evaluate(`if (!window.axe) { ${axeSource} }`);
  const findings = await page.evaluate(async () => {
    const { violations } = await window.axe.run(document, { resultTypes: ["violations"] });
    return violations
      .filter((v) => v.impact === "serious" || v.impact === "critical")
      .map((v) => `${v.id}: ${v.help}: ${v.nodes.map((n) => n.target.join(" ")).slice(0, 4).join(", ")}`);
  });
  assert.deepEqual(findings, [], where);
}

// What the page shows now, in numbers.
export const shown = (page) => page.evaluate(() => {
  const { player } = window.groundlock.model;
  const r = player.current.value;
  return r && {
    sequence: r.sequence,
    timeS: r.timeS,
    cameraState: r.result.camera?.state,
    matches: r.result.camera?.matchXyPx.length ?? 0,
    targets: r.result.targets.map((t) => ({
      id: t.targetId, state: t.state, confidence: t.confidence,
      box: t.box && { x: t.box.x, y: t.box.y, width: t.box.width, height: t.box.height },
      world: !!t.boxWorld,
    })),
    frames: player.history.length,
    images: player.history.images.size,
  };
});

// What the page has kept, oldest first; of one target, or of any.
export const history = (page, target) => page.evaluate((id) => {
  const { history } = window.groundlock.model.player;
  return Array.from({ length: history.length }, (_, i) => {
    const r = history.at(i);
    const targets = r.result.targets.filter((t) => id === null || t.targetId === id);
    const box = targets[0]?.box;
    return {
      sequence: r.sequence,
      timeS: r.timeS,
      box: box && { x: box.x, y: box.y, width: box.width, height: box.height },
      world: targets.some((t) => t.boxWorld),
    };
  });
}, target ?? null);

export async function screenshot(page, name) {
  const folder = process.env.GROUNDLOCK_SCREENSHOTS;
  if (folder) await page.screenshot({ path: join(folder, `${name}.jpg`), type: "jpeg", quality: 88 });
}

export function overlap(a, b) {
  const w = Math.min(a.x + a.width, b.x + b.width) - Math.max(a.x, b.x);
  const h = Math.min(a.y + a.height, b.y + b.height) - Math.max(a.y, b.y);
  const common = Math.max(0, w) * Math.max(0, h);
  return common / (a.width * a.height + b.width * b.height - common);
}
