// SPDX-License-Identifier: Apache-2.0
// The real programs, started for a test and ended with it; and a network that
// can be cut.
import { execFileSync, spawn } from "node:child_process";
import { once } from "node:events";
import { cpSync, existsSync, mkdirSync, mkdtempSync, openSync, readFileSync, rmSync } from "node:fs";
import { createConnection, createServer } from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { setTimeout as sleep } from "node:timers/promises";
import { connect } from "groundlock";

export const BIN = process.env.GROUNDLOCK_BIN;
const scratch = mkdtempSync(join(tmpdir(), "groundlock-typescript-"));
let folders = 0;
export function folder() {
  const path = join(scratch, String(folders++));
  mkdirSync(path);
  return path;
}

export async function until(what, probe, seconds = 120) {
  const end = Date.now() + 1000 * seconds;
  for (;;) {
    const value = await probe();
    if (value) return value;
    if (Date.now() > end) throw new Error(`waited ${seconds} s for ${what}`);
    await sleep(20);
  }
}

// Above these the system chooses ports for whoever wants any.
const chosenFrom = Number(readFileSync("/proc/sys/net/ipv4/ip_local_port_range", "utf8").split(/\s+/)[0]);
/** A port for a server that is to listen there again after it was killed: of those that nobody is given meanwhile. */
export async function lastingPort() {
  for (;;) {
    const port = Math.floor(10_000 + Math.random() * (Math.max(chosenFrom, 11_000) - 10_000));
    const probe = createServer();
    const free = await new Promise((done) => {
      probe.once("error", () => done(false));
      probe.listen(port, "127.0.0.1", () => probe.close(() => done(true)));
    });
    if (free) return port;
  }
}

/** groundlock-server on a store of its own; kill() and start() again keep the port. */
export class Server {
  static #running = new Set();
  port = 0;

  static async start(path, ...args) {
    const server = new Server();
    server.port = await lastingPort();
    server.path = path;
    server.args = args;
    await server.start();
    return server;
  }
  static async stopAll() {
    await Promise.all([...Server.#running].map((server) => server.stop()));
    rmSync(scratch, { recursive: true, force: true });
  }

  get address() {
    return `127.0.0.1:${this.port}`;
  }
  async start() {
    const portFile = join(this.path, "port");
    rmSync(portFile, { force: true });
    const log = openSync(join(this.path, "server.log"), "a");
    this.child = spawn(
      join(BIN, "groundlock-server"),
      ["--listen", `127.0.0.1:${this.port}`, "--metrics", "", "--store", join(this.path, "store"),
        "--port-file", portFile, ...this.args],
      { stdio: ["ignore", log, log] },
    );
    this.exited = once(this.child, "exit");
    Server.#running.add(this);
    await until("the server", () => {
      if (this.child.exitCode !== null) throw new Error(readFileSync(join(this.path, "server.log"), "utf8"));
      return existsSync(portFile) && readFileSync(portFile, "utf8").trim();
    });
  }
  async kill() {
    this.child.kill("SIGKILL");
    await this.exited;
  }
  async stop() {
    Server.#running.delete(this);
    if (this.child.exitCode !== null || this.child.signalCode !== null) return;
    this.child.kill("SIGTERM");
    const late = setTimeout(() => this.child.kill("SIGKILL"), 120_000);
    await this.exited;
    clearTimeout(late);
  }
}

/** A TCP proxy to a port whose connections can be cut. */
export class Network {
  up = true;
  bytesUp = 0;
  /** Bytes up at which all connections break, once. */
  cutAt = Infinity;
  #open = new Set();

  static async to(port) {
    const network = new Network();
    network.listener = createServer((near) => {
      if (!network.up) return near.destroy();
      const far = createConnection(port, "127.0.0.1");
      near.on("data", (data) => {
        network.bytesUp += data.length;
        if (network.bytesUp < network.cutAt) return;
        network.cutAt = Infinity;
        network.cut();
      });
      near.pipe(far).pipe(near);
      for (const [end, other] of [[near, far], [far, near]]) {
        network.#open.add(end);
        end.on("error", () => undefined);
        end.on("close", () => other.destroy());
      }
    });
    network.listener.listen(0, "127.0.0.1");
    await once(network.listener, "listening");
    return network;
  }
  get address() {
    return `127.0.0.1:${this.listener.address().port}`;
  }
  cut() {
    for (const end of this.#open) end.destroy();
    this.#open.clear();
  }
  close() {
    this.listener.close();
    this.cut();
  }
}

function findScene() {
  let path = join(process.env.GROUNDLOCK_DATA ?? "", "sim/lot");
  if (!existsSync(join(path, "occlusion.mp4"))) {
    path = join(process.env.GROUNDLOCK_SCRATCH ?? tmpdir(), "groundlock-yard");
    if (!existsSync(join(path, "map"))) {
      for (const sequence of ["mapping", "occlusion"]) {
        execFileSync(
          join(BIN, "groundlock"),
          ["simulate", "yard", sequence, "--size", "640x360", "--samples", "2", "--out", path],
          { stdio: "ignore" },
        );
      }
    }
  }
  const [head, ...lines] = readFileSync(join(path, "occlusion_truth.csv"), "utf8").trim().split("\n");
  const names = head.split(",");
  const truth = lines.map((line) => Object.fromEntries(line.split(",").map((v, i) => [names[i], Number(v)])));
  const box = ["x", "y", "w", "h"].map((n) => truth[0][`vis_${n}`]);
  return {
    path, truth, box, video: join(path, "occlusion.mp4"), camera: join(path, "camera.json"),
    map: join(path, "map"), align: join(path, "align.json"),
  };
}
export const scene = findScene();

let stored;
/** A server of the test's own, with the map `yard`. */
export async function ownServer(...args) {
  stored ??= (async () => {
    const path = folder();
    const server = await Server.start(path);
    const client = await connect({ server: server.address });
    await client.importMap("yard", scene.map, { align: scene.align });
    await client.close();
    await server.stop();
    return join(path, "store");
  })();
  const path = folder();
  cpSync(await stored, join(path, "store"), { recursive: true });
  return Server.start(path, ...args);
}

let shared;
/** One that all tests may use which do not kill it. */
export const sharedServer = () => (shared ??= ownServer());
