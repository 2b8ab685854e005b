// SPDX-License-Identifier: Apache-2.0
// Every example of docs/typescript.md compiles under tsc --strict, and all but those
// that speak of other machines and of a page run.
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
const untried = [...page.matchAll(/^```ts no-run\n(.*?)^```/gms)].map((match) => match[1]);
// What the examples that are compiled alone take as given.
const given = {
  connect: 'import { connect } from "groundlock";',
  token: "declare const token: string;",
  dashboard: 'declare const dashboard: import("groundlock/browser").Dashboard;',
  align: 'declare const align: import("groundlock").SimilarityTransform;',
  draw: "declare function draw(...things: unknown[]): void;",
  show: "declare function show(stage: string, fraction: number): void;",
  folderInput: "declare const folderInput: { files: FileList };",
  photoInput: "declare const photoInput: { files: FileList };",
  stopButton: "declare const stopButton: AbortController;",
  from: 'declare const from: import("groundlock").MapPoint;',
  to: 'declare const to: import("groundlock").MapPoint;',
  recordedByMediaRecorder: "declare const recordedByMediaRecorder: Blob;",
};
const out = join(here, "docs");
let place;

before(async () => {
  assert.ok(blocks.length >= 4);
  mkdirSync(out, { recursive: true });
  blocks.forEach((block, i) => writeFileSync(join(out, `example${i}.mts`), block));
  untried.forEach((block, i) => {
    const missing = Object.keys(given).filter((name) =>
      new RegExp(`\\b${name}\\b`).test(block) && !new RegExp(`(const|import) (${name}\\b|\\{[^}]*\\b${name}\\b)`).test(block));
    writeFileSync(join(out, `untried${i}.mts`), [...missing.map((name) => given[name]), block, "export {};"].join("\n"));
  });
  const tsc = createRequire(import.meta.url).resolve("typescript/bin/tsc");
  const compile = (files, ...more) => execFileSync(process.execPath, [
    tsc, "--strict", "--noUncheckedIndexedAccess", "--target", "ES2022", "--module", "NodeNext", "--types", "node", ...more, ...files,
  ], { stdio: "inherit", cwd: here });
  compile(blocks.map((_, i) => join(out, `example${i}.mts`)));
  compile(untried.map((_, i) => join(out, `untried${i}.mts`)), "--lib", "ES2022,ESNext.Disposable,DOM,DOM.Iterable", "--noEmit", "--skipLibCheck");
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
