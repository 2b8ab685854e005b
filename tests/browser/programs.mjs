// SPDX-License-Identifier: Apache-2.0
// The real programs, started for a test and ended with it.
import { execFileSync, spawn } from "node:child_process";
import { existsSync, mkdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { join } from "node:path";

const bin = process.env.GROUNDLOCK_BIN;
const data = process.env.GROUNDLOCK_DATA;
const scratch = process.env.GROUNDLOCK_BROWSER_SCRATCH;

export const TOKEN = "a-token-of-the-browser-test";

const running = new Set();

export function start(program, args, log) {
  const child = spawn(join(bin, program), args, { stdio: ["ignore", "pipe", "pipe"] });
  child.output = "";
  for (const stream of [child.stdout, child.stderr]) {
    stream.on("data", (text) => {
      child.output = (child.output + text).slice(-20_000);
      if (log) process.stderr.write(text);
    });
  }
  running.add(child);
  child.exited = new Promise((resolve) => child.on("exit", (code, signal) => {
    running.delete(child);
    resolve({ code, signal });
  }));
  return child;
}

export async function stop(child, signal = "SIGTERM") {
  if (!running.has(child)) return;
  child.kill(signal);
  const late = setTimeout(() => child.kill("SIGKILL"), 120_000);
  await child.exited;
  clearTimeout(late);
}

export const stopAll = () => Promise.all([...running].map((child) => stop(child)));

export async function until(what, probe, seconds = 240) {
  const end = Date.now() + 1000 * seconds;
  for (;;) {
    const value = await probe();
    if (value) return value;
    if (Date.now() > end) throw new Error(`waited ${seconds} s for ${what}`);
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
}

async function portOf(child, file) {
  await until(`${file}\n${child.output}`, () => {
    if (!running.has(child)) throw new Error(`a program ended:\n${child.output}`);
    return existsSync(file) && readFileSync(file, "utf8").trim() !== "";
  });
  return Number(readFileSync(file, "utf8"));
}

export async function startServer(folder, port = 0) {
  const portFile = join(folder, "server.port");
  rmSync(portFile, { force: true });
  const tokens = join(folder, "tokens");
  writeFileSync(tokens, `${TOKEN}\n`, { mode: 0o600 });
  const child = start("groundlock-server", [
    "--listen", `127.0.0.1:${port}`, "--store", join(folder, "store"), "--metrics", "",
    "--port-file", portFile, "--token-file", tokens,
  ]);
  child.port = await portOf(child, portFile);
  return child;
}

export async function startDashboard(folder, serverPort, sources) {
  const portFile = join(folder, "dashboard.port");
  const child = start("groundlock-dashboard", [
    "--listen", "127.0.0.1:0", "--server", `127.0.0.1:${serverPort}`, "--port-file", portFile,
    "--web", process.env.GROUNDLOCK_WEB, "--data", join(folder, "dashboard"), "--sources", sources,
    "--token-file", join(folder, "tokens"),
  ]);
  child.port = await portOf(child, portFile);
  return child;
}

export function groundlock(folder, serverPort, ...args) {
  return execFileSync(join(bin, "groundlock"), [
    ...args, "--server", `127.0.0.1:${serverPort}`, "--token-file", join(folder, "tokens"),
  ], { encoding: "utf8", stdio: ["ignore", "pipe", "pipe"] });
}

// Streams the scene's video as a camera would, at its own pace.
export function stream(folder, serverPort, scene, session) {
  return start("groundlock", [
    "track", scene.video, "--map", "yard", "--camera", scene.camera, "--session", session,
    "--realtime", "--host-clock", "--matches", "--movers", join(folder, "movers.csv"),
    "--server", `127.0.0.1:${serverPort}`, "--token-file", join(folder, "tokens"),
  ]);
}

// A sequence with its map, camera and truth: from the data folder, else
// rendered. The video runs forth and back for minutes, so that nothing jumps.
export function prepareScene() {
  mkdirSync(scratch, { recursive: true });
  const given = join(data ?? "", "sim/lot");
  const scene = existsSync(join(given, "occlusion.mp4")) ? {
    folder: given, width: 1280,
  } : { folder: join(scratch, "yard"), width: 640 };
  if (scene.width === 640 && !existsSync(join(scene.folder, "done"))) {
    for (const sequence of ["mapping", "occlusion"]) {
      execFileSync(join(bin, "groundlock"), [
        "simulate", "yard", sequence, "--size", "640x360", "--samples", "2", "--out", scene.folder,
      ], { stdio: "ignore" });
    }
    writeFileSync(join(scene.folder, "done"), "");
  }
  const sources = join(scratch, `sources-${scene.width}`);
  mkdirSync(sources, { recursive: true });
  scene.sources = sources;
  scene.video = join(sources, "drive.mp4");
  scene.camera = join(sources, "drive.camera.json");
  scene.map = join(scene.folder, "map");
  scene.align = join(scene.folder, "align.json");
  writeFileSync(scene.camera, readFileSync(join(scene.folder, "camera.json")));
  if (!existsSync(scene.video)) {
    const there = join(scratch, `round-${scene.width}.mp4`);
    const ffmpeg = (...args) => execFileSync("ffmpeg", ["-v", "error", "-y", ...args]);
    ffmpeg("-i", join(scene.folder, "occlusion.mp4"), "-filter_complex",
      "[0]split[a][b];[b]reverse[c];[a][c]concat", "-c:v", "libx264", "-preset", "veryfast", "-crf", "22", there);
    ffmpeg("-stream_loop", "20", "-i", there, "-c", "copy", scene.video);
  }
  const rows = readFileSync(join(scene.folder, "occlusion_truth.csv"), "utf8").trim().split("\n");
  const names = rows[0].split(",");
  const truth = rows.slice(1).map((row) =>
    Object.fromEntries(row.split(",").map((v, i) => [names[i], v === "" ? null : Number(v)])));
  const count = truth.length;
  // Forth and back: 0 1 ... n-1 n-1 ... 1 0 0 1 ...
  scene.truthOf = (sequence) => {
    const k = sequence % (2 * count);
    return truth[k < count ? k : 2 * count - 1 - k];
  };
  return scene;
}

export function residentBytes(child) {
  const status = readFileSync(`/proc/${child.pid}/status`, "utf8");
  return 1024 * Number(/VmRSS:\s+(\d+)/.exec(status)[1]);
}
