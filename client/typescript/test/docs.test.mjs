// SPDX-License-Identifier: Apache-2.0
// Every example of docs/typescript.md compiles under tsc --strict and runs.
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdirSync, readFileSync, symlinkSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { Server, folder, scene } from "./support.mjs";

const here = dirname(fileURLToPath(import.meta.url));
const page = readFileSync(join(here, "typescript.md"), "utf8");
// On a server of their own: one that runs on this machine is not for tests.
const blocks = [...page.matchAll(/^```ts\n(.*?)^```/gms)].map((match) =>
  match[1].replaceAll("connect()", "connect({ local: true })"));
const out = join(here, "docs");
let place;

before(async () => {
  assert.ok(blocks.length >= 4);
  mkdirSync(out, { recursive: true });
  blocks.forEach((block, i) => writeFileSync(join(out, `example${i}.mts`), block));
  const tsc = createRequire(import.meta.url).resolve("typescript/bin/tsc");
  const files = blocks.map((_, i) => join(out, `example${i}.mts`));
  execFileSync(process.execPath, [
    tsc, "--strict", "--noUncheckedIndexedAccess", "--target", "ES2022", "--module", "NodeNext", "--types", "node", ...files,
  ], { stdio: "inherit", cwd: here });
  place = folder();
  symlinkSync(scene.map, join(place, "reconstruction"));
  for (const name of ["camera.json", "align.json"]) symlinkSync(join(scene.path, name), join(place, name));
  execFileSync("ffmpeg", ["-v", "error", "-i", scene.video, "-frames:v", "6", "-c:v", "libx264", "-preset", "ultrafast",
    "-crf", "16", join(place, "drive.mp4")]);
});
after(() => Server.stopAll());

blocks.forEach((block, i) =>
  test(`example ${i + 1}`, () => {
    const told = execFileSync(process.execPath, [join(out, `example${i}.mjs`)], {
      cwd: place, encoding: "utf8", env: { ...process.env, XDG_DATA_HOME: join(place, "data") }, timeout: 600_000,
    });
    if (block.includes("results.csv")) {
      assert.equal(readFileSync(join(place, "results.csv"), "utf8").trim().split("\n").length, 7);
    }
    assert.ok(told.length > 0);
  }),
);
