// SPDX-License-Identifier: Apache-2.0
// Files to and from the server.
import { chmodSync, existsSync, mkdirSync, mkdtempSync, readdirSync, renameSync, rmSync, statSync } from "node:fs";
import { type FileHandle, open } from "node:fs/promises";
import { basename, dirname, extname, isAbsolute, join, relative, resolve } from "node:path";
import { choice } from "./checks.js";
import { EXPORT_FORMATS, MAP_FORMATS } from "./convert.js";
import { Code, GroundlockError, badArgument, notFound } from "./errors.js";
import type { ExportMapResponse } from "./gen/groundlock/v1/maps_pb.js";
import type { MapExportFormat, MapFormat, Progress } from "./types.js";

// A quarter of what the server takes: progress moves visibly.
const CHUNK_BYTES = 256 << 10;

export interface LocalFile {
  readonly path: string;
  readonly remote: string;
}
/** What an import sends: see ImportMapRequest.Header. */
export interface ImportFiles {
  readonly format: MapFormat;
  readonly files: readonly LocalFile[];
  readonly model: string;
  readonly database: string;
  readonly images: string;
}

type Part =
  | { case: "fileStart"; value: { path: string; sizeBytes: bigint } }
  | { case: "chunk"; value: Uint8Array<ArrayBuffer> };

/** The parts of an upload, and how far it is. */
export class Upload {
  readonly total: number;
  done = 0;
  complete = false;

  constructor(readonly files: readonly LocalFile[]) {
    this.total = files.reduce((sum, file) => {
      if (!existsSync(file.path)) throw new GroundlockError(Code.NOT_FOUND, `${file.path}: no such file`);
      return sum + statSync(file.path).size;
    }, 0);
  }

  progress(stage: string): Progress {
    const fraction = this.total > 0 ? this.done / this.total : 1;
    return { stage, fraction, note: "", bytesDone: this.done, bytesTotal: this.total };
  }

  async *parts(): AsyncGenerator<Part> {
    for (const file of this.files) {
      let handle: FileHandle | undefined;
      try {
        handle = await open(file.path, "r");
        let missing = (await handle.stat()).size;
        yield { case: "fileStart", value: { path: file.remote, sizeBytes: BigInt(missing) } };
        while (missing > 0) {
          const chunk = new Uint8Array(Math.min(missing, CHUNK_BYTES));
          const { bytesRead } = await handle.read(chunk);
          if (bytesRead === 0) {
            throw new GroundlockError(Code.DATA_LOSS, `${file.path}: became shorter while it was read`);
          }
          missing -= bytesRead;
          yield { case: "chunk", value: chunk.subarray(0, bytesRead) };
          this.done += bytesRead;
        }
      } finally {
        await handle?.close();
      }
    }
    this.complete = true;
  }
}

// --- what to import -----------------------------------------------------------

const IMAGES = [".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp", ".ppm", ".pgm"];

// The file that each format's tool writes, and the ends of the names of those
// with an image's features; what has none has them taken from the images.
const MODELS: Partial<Record<MapFormat, { model: RegExp; features: readonly string[] }>> = {
  nvm: { model: /\.nvm$/i, features: [".sift"] },
  bundler: { model: /^bundle\.out$/, features: [".key", ".key.gz"] },
  openmvg: { model: /^sfm_data\.json$/, features: [".feat", ".desc"] },
  opensfm: { model: /^reconstruction\.json$/, features: [] },
  groundlock: { model: /\.glmap$/i, features: [] },
};
const LISTS = ["list.txt", "image_describer.json"];
const EXPECTED =
  "expected a folder with a COLMAP model, or VisualSFM's .nvm, Bundler's bundle.out, OpenMVG's sfm_data.json, " +
  "OpenSfM's reconstruction.json or a .glmap file";

const isFile = (path: string): boolean => existsSync(path) && statSync(path).isFile();
const isFolder = (path: string): boolean => existsSync(path) && statSync(path).isDirectory();

function tree(folder: string): string[] {
  return readdirSync(folder, { withFileTypes: true })
    .sort((a, b) => (a.name < b.name ? -1 : 1))
    .flatMap((entry) => {
      const path = join(folder, entry.name);
      if (isFolder(path)) return tree(path);
      return isFile(path) ? [path] : [];
    });
}

function colmapFiles(path: string, database: string | undefined): ImportFiles | undefined {
  const endings = [".bin", ".txt"];
  const parts = ["cameras", "images", "points3D"];
  const ending = (folder: string): string | undefined =>
    endings.find((e) => parts.every((p) => isFile(join(folder, p + e))));
  const size = (folder: string): number => tree(folder).reduce((sum, f) => sum + statSync(f).size, 0);
  let folder: string | undefined;
  for (const candidate of [path, join(path, "sparse")]) {
    if (!isFolder(candidate)) continue;
    const numbered = readdirSync(candidate)
      .filter((name) => /^\d+$/.test(name))
      .map((name) => join(candidate, name))
      .filter((f) => isFolder(f) && ending(f));
    folder ??= ending(candidate) ? candidate : numbered.sort((a, b) => size(b) - size(a))[0];
  }
  if (folder === undefined) return undefined;
  const files = [...parts, "rigs", "frames"]
    .map((part) => part + (ending(folder) as string))
    .filter((name) => isFile(join(folder, name)))
    .map((name) => ({ path: join(folder, name), remote: `model/${name}` }));
  if (database !== undefined && !isFile(database)) throw notFound("database", `${database}: no such file`);
  const above = [folder, dirname(folder), dirname(dirname(folder))];
  const found = database ?? above.map((f) => join(f, "database.db")).find(isFile);
  if (found !== undefined) files.push({ path: found, remote: "database.db" });
  return { format: "colmap", files, model: "model", database: found ? "database.db" : "", images: "" };
}

function modelFile(path: string, format: MapFormat): { format: MapFormat; model: string } {
  const wanted = Object.entries(MODELS).filter(([name]) => format === "auto" || format === name);
  if (isFile(path)) {
    const known = Object.entries(MODELS).find(([, m]) => m.model.test(basename(path)))?.[0];
    const kind = format === "auto" ? known : format;
    if (kind === undefined) throw badArgument("path", `${path}: ${EXPECTED}`);
    return { format: kind as MapFormat, model: path };
  }
  for (const [name, { model }] of wanted) {
    const found = [path, join(path, "bundle")]
      .filter((f) => f === path || name === "bundler")
      .flatMap((f) => (isFolder(f) ? readdirSync(f).filter((n) => model.test(n)).map((n) => join(f, n)) : []));
    if (found.length > 1) {
      throw badArgument("path", `${path} holds ${found.map((f) => basename(f)).join(", ")}: name the one to import`);
    }
    if (found[0]) return { format: name as MapFormat, model: found[0] };
  }
  throw notFound("path", `${path}: no model here; ${EXPECTED}`);
}

/** From what a person names to the files of a reconstruction. The server reads
 * them, and says what is wrong with them. */
export function findImportFiles(
  path: string,
  options: { readonly format?: MapFormat; readonly database?: string; readonly images?: string },
): ImportFiles {
  const wanted = options.format ?? "auto";
  choice("format", wanted, MAP_FORMATS);
  if (!existsSync(path)) throw notFound("path", `${path}: no such file or folder`);
  if (wanted === "auto" || wanted === "colmap") {
    const colmap = isFolder(path) ? colmapFiles(path, options.database) : undefined;
    if (colmap) return colmap;
    if (wanted === "colmap") {
      throw notFound("path", `${path}: no cameras, images and points3D files (.bin or .txt) here or in sparse/`);
    }
  }
  const { format, model } = modelFile(path, wanted);
  const files: LocalFile[] = [{ path: model, remote: basename(model) }];
  if (format === "groundlock") return { format, files, model: basename(model), database: "", images: "" };
  if (format === "opensfm") {
    const tracks = readdirSync(dirname(model)).filter((name) => /^tracks.*\.csv$/.test(name));
    files.push(...tracks.map((name) => ({ path: join(dirname(model), name), remote: name })));
  }
  if (options.images !== undefined && !isFolder(options.images)) {
    throw notFound("images", `${options.images}: no such folder`);
  }
  const top = basename(dirname(model)) === "bundle" ? dirname(dirname(model)) : dirname(model);
  const folder = options.images ?? (isFolder(join(top, "images")) ? join(top, "images") : top);
  const all = tree(folder).filter((f) => f !== model);
  const features = MODELS[format]?.features ?? [];
  let chosen = all.filter((f) => features.some((e) => f.toLowerCase().endsWith(e)));
  if (chosen.length === 0) chosen = all.filter((f) => IMAGES.includes(extname(f).toLowerCase()));
  chosen.push(...all.filter((f) => LISTS.includes(basename(f))));
  files.push(...chosen.map((f) => ({ path: f, remote: `images/${relative(folder, f)}` })));
  return { format, files, model: basename(model), database: "", images: chosen.length > 0 ? "images" : "" };
}

export function imagesIn(field: string, folder: string): string[] {
  if (!isFolder(folder)) throw notFound(field, `${folder}: no such folder`);
  const images = readdirSync(folder).filter((name) => IMAGES.includes(extname(name).toLowerCase())).sort();
  if (images.length === 0) throw notFound(field, `${folder}: holds no images`);
  return images.map((name) => join(folder, name));
}

/** The files of a build, and the remote path of the video, if it is one. */
export function findBuildFiles(
  video: string | undefined,
  images: string | readonly string[] | undefined,
): { files: LocalFile[]; videoPath: string } {
  if ((video === undefined) === (images === undefined)) {
    throw badArgument("video", "name either a video or images");
  }
  if (video !== undefined) {
    if (!isFile(video)) throw notFound("video", `${video}: no such file`);
    return { files: [{ path: video, remote: basename(video) }], videoPath: basename(video) };
  }
  const photos = typeof images === "string" ? imagesIn("images", images) : [...(images ?? [])].sort();
  return { files: photos.map((path) => ({ path, remote: basename(path) })), videoPath: "" };
}

// --- exports ------------------------------------------------------------------

/** Writes what an export stream brings to a folder beside the target, and moves
 * it there when it is whole. */
export class ExportReceiver {
  readonly warnings: string[] = [];
  readonly #format: MapExportFormat;
  readonly #target: string;
  readonly #scratch: string;
  readonly #root: string;
  #single: string | undefined;
  #file: FileHandle | undefined;
  #done = 0;
  #total = 0;

  constructor(path: string, format: MapExportFormat) {
    choice("format", format, EXPORT_FORMATS);
    this.#format = format;
    this.#target = resolve(path);
    if (existsSync(this.#target)) {
      throw new GroundlockError(Code.ALREADY_EXISTS, `path: ${path}: exists`, "path");
    }
    try {
      this.#scratch = mkdtempSync(join(dirname(this.#target), ".groundlock-"));
    } catch (error) {
      throw badArgument("path", `${path}: ${(error as Error).message}`);
    }
    this.#root = join(this.#scratch, "export");
    mkdirSync(this.#root);
  }

  progress(): Progress {
    // Nothing is known while the server makes the files.
    const stage = this.#total === 0 ? "preparing" : "downloading";
    const fraction = this.#total === 0 ? 0 : this.#done / this.#total;
    return { stage, fraction, note: "", bytesDone: this.#done, bytesTotal: this.#total };
  }

  async take(message: ExportMapResponse): Promise<void> {
    this.warnings.push(...message.warnings);
    const part = message.message;
    if (part.case === "fileStart") {
      const path = part.value.path;
      if (isAbsolute(path) || path.split("/").includes("..")) {
        throw new GroundlockError(Code.INTERNAL, `the server sent a file outside of the export: ${path}`);
      }
      await this.#close();
      if (path === "") this.#single = join(this.#scratch, "single");
      const local = path === "" ? (this.#single as string) : join(this.#root, path);
      mkdirSync(dirname(local), { recursive: true });
      this.#file = await open(local, "w");
      this.#total += Number(part.value.sizeBytes);
    } else if (part.case === "chunk") {
      if (!this.#file) throw new GroundlockError(Code.INTERNAL, "the server sent bytes of no file");
      try {
        await this.#file.writeFile(part.value);
      } catch (error) {
        throw new GroundlockError(Code.RESOURCE_EXHAUSTED, `${this.#target}: ${(error as Error).message}`);
      }
      this.#done += part.value.length;
    }
  }

  /** Moves what has arrived to its place. */
  async place(): Promise<void> {
    await this.#close();
    if (this.#done !== this.#total) {
      throw new GroundlockError(Code.DATA_LOSS, "the server sent less than it announced");
    }
    if (this.#single !== undefined) {
      renameSync(this.#single, this.#target);
    } else if (this.#format === "nvm") {
      // The model under the name that was asked for, its features beside.
      const moves = readdirSync(this.#root).map((name) => ({
        from: join(this.#root, name),
        to: name.endsWith(".nvm") ? this.#target : join(dirname(this.#target), name),
      }));
      const taken = moves.find(({ to }) => existsSync(to));
      if (taken) throw new GroundlockError(Code.ALREADY_EXISTS, `${taken.to}: exists`);
      for (const { from, to } of moves) renameSync(from, to);
    } else {
      renameSync(this.#root, this.#target);
      chmodSync(this.#target, 0o755);
    }
  }

  async close(): Promise<void> {
    await this.#close();
    rmSync(this.#scratch, { recursive: true, force: true });
  }

  async #close(): Promise<void> {
    const file = this.#file;
    this.#file = undefined;
    await file?.close();
  }
}
