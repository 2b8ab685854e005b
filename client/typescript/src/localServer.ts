// SPDX-License-Identifier: Apache-2.0
// A server of the program's own, for a person who has started none; and
// connect(), which chooses one.
import { type ChildProcess, spawn } from "node:child_process";
import { once } from "node:events";
import { accessSync, closeSync, constants, mkdirSync, mkdtempSync, openSync, readFileSync, rmSync } from "node:fs";
import { createConnection } from "node:net";
import { homedir, tmpdir } from "node:os";
import { delimiter, dirname, isAbsolute, join, resolve } from "node:path";
import { setTimeout as sleep } from "node:timers/promises";
import { type ConnectOptions, DEFAULT_PORT } from "./channel.js";
import { Client } from "./client.js";
import { Code, GroundlockError, badArgument, notFound, show } from "./errors.js";

// A store of thousands of maps opens in well under a second.
const START_LIMIT_MS = 30_000;
const STOP_LIMIT_MS = 10_000;
const POLL_MS = 20;

/** Where a person's own maps are, as of `groundlock --local`. */
export function userDataFolder(): string {
  const data = process.env["XDG_DATA_HOME"];
  return data && isAbsolute(data) ? join(data, "groundlock") : join(homedir(), ".local", "share", "groundlock");
}

function isProgram(path: string): boolean {
  try {
    accessSync(path, constants.X_OK);
    return true;
  } catch {
    return false;
  }
}

function inPath(name: string): string | undefined {
  const folders = (process.env["PATH"] ?? "").split(delimiter).filter(Boolean);
  return folders.map((folder) => join(folder, name)).find(isProgram);
}

export interface LocalServerOptions {
  /** The program; left out = $GROUNDLOCK_BIN/groundlock-server where that is set, else the one in $PATH. */
  readonly program?: string;
  /** The folder of the maps; left out = the user's. */
  readonly store?: string;
  /** Further arguments of the server. */
  readonly arguments?: readonly string[];
}

/** groundlock-server as a child process on a free port of the loopback address,
 * until stop() or the end of this process. Programs that run at the same time
 * may each have one: they share the store. */
export class LocalServer {
  readonly #child: ChildProcess;
  readonly #exited: Promise<unknown>;

  private constructor(child: ChildProcess, exited: Promise<unknown>, readonly address: string, readonly store: string) {
    this.#child = child;
    this.#exited = exited;
  }

  get pid(): number {
    return this.#child.pid ?? 0;
  }

  /** NOT_FOUND: there is no such program. UNAVAILABLE: it ended at once or takes
   * too long; names its log. */
  static async start(options: LocalServerOptions = {}): Promise<LocalServer> {
    if (options.program !== undefined && !isProgram(options.program)) {
      throw notFound("program", `${options.program}: is no program`);
    }
    const own = process.env["GROUNDLOCK_BIN"] && join(process.env["GROUNDLOCK_BIN"], "groundlock-server");
    const program = options.program ?? (own && isProgram(own) ? resolve(own) : inPath("groundlock-server"));
    if (program === undefined) {
      const what = "groundlock-server is not in PATH: install it, or name the HOST:PORT of a running one";
      throw new GroundlockError(Code.NOT_FOUND, what);
    }
    const store = resolve(options.store ?? join(userDataFolder(), "maps"));
    const log = join(dirname(store), "server.log");
    const scratch = mkdtempSync(join(tmpdir(), "groundlock-"));
    const portFile = join(scratch, "port");
    // util-linux' way to ask the kernel to end a child with its parent.
    const setpriv = inPath("setpriv");
    const command = [
      ...(setpriv ? [setpriv, "--pdeathsig", "TERM", "--"] : []), program,
      "--listen", "127.0.0.1:0", "--metrics", "", "--store", store, "--port-file", portFile, "--grace", "2",
      ...(options.arguments ?? []),
    ];
    try {
      mkdirSync(store, { recursive: true });
      const out = openSync(log, "a", 0o600);
      // Detached: Ctrl-C in the terminal is for the client, which then ends its session.
      const child = spawn(command[0] as string, command.slice(1), { stdio: ["ignore", out, out], detached: true });
      closeSync(out);
      const exited = Promise.race([once(child, "exit"), once(child, "error")]).catch(() => undefined);
      child.unref();
      const server = new LocalServer(child, exited, await port(child, portFile, log), store);
      return server;
    } finally {
      rmSync(scratch, { recursive: true, force: true });
    }
  }

  /** Asks it to end, and waits. */
  async stop(): Promise<void> {
    if (this.#child.exitCode !== null || this.#child.signalCode !== null) return;
    this.#child.ref();
    this.#child.kill("SIGTERM");
    const late = setTimeout(() => this.#child.kill("SIGKILL"), STOP_LIMIT_MS);
    await this.#exited;
    clearTimeout(late);
  }
}

async function port(child: ChildProcess, portFile: string, log: string): Promise<string> {
  const end = Date.now() + START_LIMIT_MS;
  for (;;) {
    // The server writes the file whole, and only once it serves.
    let text = "";
    try {
      text = readFileSync(portFile, "utf8").trim();
    } catch {
      // not there yet
    }
    if (text !== "") return `127.0.0.1:${Number(text)}`;
    if (child.exitCode !== null || child.signalCode !== null || child.pid === undefined) {
      throw new GroundlockError(Code.UNAVAILABLE, `the program's own server ended at once; its log: ${log}`);
    }
    if (Date.now() > end) {
      child.kill("SIGKILL");
      const what = `the program's own server does not serve after ${START_LIMIT_MS / 1000} s; its log: ${log}`;
      throw new GroundlockError(Code.UNAVAILABLE, what);
    }
    await sleep(POLL_MS);
  }
}

function loopbackAnswers(): Promise<boolean> {
  return new Promise((done) => {
    const probe = createConnection({ host: "127.0.0.1", port: DEFAULT_PORT, timeout: 1000 });
    const finish = (answer: boolean): void => {
      probe.destroy();
      done(answer);
    };
    probe.once("connect", () => finish(true));
    probe.once("error", () => finish(false));
    probe.once("timeout", () => finish(false));
  });
}

export interface OpenOptions extends ConnectOptions {
  /** HOST:PORT, or grpcs://HOST:PORT for TLS. Left out = the one on this
   * machine's port 50551, or where none answers, one of the program's own that
   * lives as long as the client. */
  readonly server?: string;
  /** One of the program's own in any case. */
  readonly local?: boolean;
}

/** Connects to a server, or starts one where none runs. */
export async function connect(options: OpenOptions = {}): Promise<Client> {
  if (typeof options !== "object" || options === null) {
    throw badArgument("options", `${show(options)} must be an object, as in connect({ server: "HOST:PORT" })`);
  }
  const { server, local = false, ...rest } = options;
  if (local && (server !== undefined || rest.tls !== undefined)) {
    throw badArgument(server !== undefined ? "server" : "tls", "goes not together with local");
  }
  if (server !== undefined) return Client.open(server, rest);
  if (!local && (rest.tls !== undefined || (await loopbackAnswers()))) {
    return Client.open(`127.0.0.1:${DEFAULT_PORT}`, rest);
  }
  const own = await LocalServer.start();
  try {
    return await Client.open(own.address, rest, () => own.stop());
  } catch (error) {
    await own.stop();
    throw error;
  }
}
