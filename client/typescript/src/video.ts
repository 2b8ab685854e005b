// SPDX-License-Identifier: Apache-2.0
// Frames of a video file, a folder of images, a stream or a camera. Videos are
// decoded by ffmpeg as a child process: it reads all that the command line client
// reads, and tells when each frame was taken. Pixels are as they are stored: a
// rotation that the container asks for is not applied, since the lens belongs to
// them.
import { type ChildProcess, execFile, spawn } from "node:child_process";
import { existsSync, statSync } from "node:fs";
import { readFile } from "node:fs/promises";
import { extname } from "node:path";
import { createInterface } from "node:readline";
import type { Readable } from "node:stream";
import { promisify } from "node:util";
import { aboveZero, whole } from "./checks.js";
import { Code, GroundlockError, badArgument, notFound } from "./errors.js";
import { imagesIn } from "./files.js";
import { type Image, imageOf } from "./images.js";

const run = promisify(execFile);
const IS_URL = /^[a-z][a-z0-9+.-]*:\/\//;

export interface VideoFrame {
  readonly sequence: number; // 0-based, in the input
  readonly captureTimeNs: bigint; // of a file: 0 at its first frame
  readonly image: Image; // bgr8, or a folder's JPEG or PNG as it is
}
export interface VideoOptions {
  readonly fps?: number; // of a folder of images; left out = 25
  readonly first?: number; // frames [first, last) of the input
  readonly last?: number;
}

/** Frames of a video file, a folder of images (sorted by name), an rtsp:// or
 * similar URL, or a V4L2 device. What it yields can be given to Session.track. */
export class Video implements AsyncIterable<VideoFrame> {
  readonly live: boolean;
  readonly #images: readonly string[] | undefined;
  readonly #first: number;
  readonly #last: number;

  private constructor(
    readonly source: string,
    readonly widthPx: number,
    readonly heightPx: number,
    readonly fps: number,
    images: readonly string[] | undefined,
    options: VideoOptions,
  ) {
    this.live = isLive(source);
    this.#images = images;
    this.#first = whole("first", options.first ?? 0);
    this.#last = options.last === undefined ? Infinity : whole("last", options.last, this.#first + 1);
  }

  /** NOT_FOUND, INVALID_ARGUMENT (not readable as a video), UNAVAILABLE (URL). */
  static async open(source: string, options: VideoOptions = {}): Promise<Video> {
    const fps = aboveZero("fps", options.fps ?? 25);
    if (!IS_URL.test(source) && !existsSync(source)) throw notFound("video", `${source}: no such file`);
    const folder = existsSync(source) && statSync(source).isDirectory();
    const images = folder ? imagesIn("video", source) : undefined;
    const probed = await probe(images?.[0] ?? source);
    return new Video(source, probed.widthPx, probed.heightPx, images ? fps : (probed.fps ?? fps), images, options);
  }

  async *[Symbol.asyncIterator](): AsyncGenerator<VideoFrame> {
    for await (const frame of this.#images ? this.#readFolder(this.#images) : this.#readVideo()) {
      if (frame.sequence >= this.#last) return;
      if (frame.sequence >= this.#first) yield frame;
    }
  }

  async *#readFolder(images: readonly string[]): AsyncGenerator<VideoFrame> {
    for (const [sequence, path] of images.entries()) {
      if (sequence < this.#first) continue;
      const captureTimeNs = BigInt(Math.round((1e9 * sequence) / this.fps));
      const data = /\.(jpe?g|png)$/i.test(extname(path)) ? await readFile(path) : await asPng(path);
      yield { sequence, captureTimeNs, image: imageOf("image", data) };
    }
  }

  async *#readVideo(): AsyncGenerator<VideoFrame> {
    // The time of each frame, ns, in ffmpeg's own form for machines; it is
    // written before the frame, so that neither waits for the other.
    const filters = "settb=1/1000000000,metadata=add:key=t:value=1,metadata=print:key=t:direct=1:file=pipe\\\\:3";
    const child = spawn(
      "ffmpeg",
      [
        "-nostdin", "-v", "error", "-noautorotate", ...input(this.source), "-map", "0:v:0", "-an", "-sn", "-dn",
        "-vf", filters, "-fps_mode", "passthrough", "-pix_fmt", "bgr24", "-f", "rawvideo", "-",
      ],
      { stdio: ["ignore", "pipe", "pipe", "pipe"] },
    );
    const ended = end(child);
    const lines = createInterface({ input: child.stdio[3] as Readable });
    const times: bigint[] = [];
    lines.on("line", (line) => {
      const found = /^frame:\d+\s+pts:(-?\d+)/.exec(line);
      if (found) times.push(BigInt(found[1] as string));
    });
    const linesEnded = new Promise<void>((done) => lines.once("close", () => done()));
    try {
      const size = 3 * this.widthPx * this.heightPx;
      let sequence = 0;
      let start = 0n;
      let last = -1n;
      for await (const data of pieces(child.stdout as Readable, size)) {
        if (data.length !== size) {
          throw new GroundlockError(Code.DATA_LOSS, `video: ${this.source}: frame ${sequence} ends in its middle`);
        }
        // The line came first; it may be read a moment later.
        while (times.length === 0) {
          const closed = await Promise.race([linesEnded.then(() => true), tick()]);
          if (closed) break;
        }
        const stamp = times.shift() ?? last + BigInt(Math.round(1e9 / this.fps));
        if (sequence === 0) start = stamp;
        const told = this.live ? process.hrtime.bigint() : stamp - start;
        // Strictly increasing, also where a container says otherwise.
        last = told > last ? told : last + 1n;
        const image: Image = { encoding: "bgr8", data, widthPx: this.widthPx, heightPx: this.heightPx };
        yield { sequence: sequence++, captureTimeNs: last, image };
      }
      const { code, complaint } = await ended;
      if (code !== 0) throw new GroundlockError(Code.DATA_LOSS, `video: ${this.source}: ffmpeg ended: ${complaint}`);
    } finally {
      child.kill("SIGKILL");
      lines.close();
    }
  }
}

const tick = (): Promise<false> => new Promise((done) => setImmediate(() => done(false)));

function isLive(source: string): boolean {
  return IS_URL.test(source) || source.startsWith("/dev/video");
}

function input(source: string): string[] {
  if (source.startsWith("/dev/video")) return ["-f", "v4l2", "-i", source];
  if (source.startsWith("rtsp://")) return ["-rtsp_transport", "tcp", "-i", source];
  // A file whose name starts with a dash, or looks like a protocol.
  return ["-i", IS_URL.test(source) ? source : `file:${source}`];
}

async function probe(source: string): Promise<{ widthPx: number; heightPx: number; fps: number | undefined }> {
  let text: string;
  try {
    const entries = "stream=width,height,avg_frame_rate";
    const { stdout } = await run("ffprobe", [
      "-v", "error", "-select_streams", "v:0", "-show_entries", entries, "-of", "json", ...input(source),
    ]);
    text = stdout;
  } catch (error) {
    const failed = error as NodeJS.ErrnoException & { stderr?: string };
    if (failed.code === "ENOENT") {
      throw new GroundlockError(Code.FAILED_PRECONDITION, "ffprobe is not in PATH: install ffmpeg");
    }
    throw unreadable(source, (failed.stderr ?? failed.message).trim().split("\n").at(-1));
  }
  const streams = (JSON.parse(text) as { streams?: { width?: number; height?: number; avg_frame_rate?: string }[] }).streams;
  const stream = streams?.[0];
  if (!stream?.width || !stream.height) throw unreadable(source);
  const [over = 0, under = 0] = (stream.avg_frame_rate ?? "").split("/").map(Number);
  return { widthPx: stream.width, heightPx: stream.height, fps: over && under ? over / under : undefined };
}

function unreadable(source: string, why?: string): GroundlockError {
  const problem = `${source}: not readable as a video${why ? `: ${why}` : ""}`;
  if (isLive(source)) return new GroundlockError(Code.UNAVAILABLE, `video: ${problem}`);
  return badArgument("video", problem);
}

function end(child: ChildProcess): Promise<{ code: number | null; complaint: string }> {
  let complaint = "";
  child.stderr?.on("data", (text: Buffer) => (complaint = (complaint + text.toString()).slice(-1000)));
  return new Promise((done, fail) => {
    child.once("error", fail);
    child.once("close", (code) => done({ code, complaint: complaint.trim().split("\n").at(-1) ?? "" }));
  });
}

/** The bytes of a stream in pieces of one size; the last may be shorter. */
async function* pieces(stream: Readable, size: number): AsyncGenerator<Uint8Array> {
  let piece = new Uint8Array(size);
  let at = 0;
  for await (const chunk of stream as AsyncIterable<Buffer>) {
    for (let from = 0; from < chunk.length; ) {
      const count = Math.min(size - at, chunk.length - from);
      piece.set(chunk.subarray(from, from + count), at);
      at += count;
      from += count;
      if (at === size) {
        yield piece;
        piece = new Uint8Array(size);
        at = 0;
      }
    }
  }
  if (at > 0) yield piece.subarray(0, at);
}

async function asPng(path: string): Promise<Buffer> {
  const { stdout } = await run(
    "ffmpeg",
    ["-nostdin", "-v", "error", "-noautorotate", "-i", `file:${path}`, "-frames:v", "1", "-c:v", "png", "-f", "image2pipe", "-"],
    { encoding: "buffer", maxBuffer: 1 << 29 },
  );
  return stdout;
}
