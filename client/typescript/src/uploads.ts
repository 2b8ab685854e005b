// SPDX-License-Identifier: Apache-2.0
// Files from a page to the dashboard, over HTTP beside the WebSocket.
/// <reference lib="dom" />
import { Code, GroundlockError, badArgument } from "./errors.js";
import type { OnProgress } from "./types.js";

/** A file as a page has it: picked, or made (`path` is what it is called there, '/' between folders). */
export type PageFile = File | { readonly path: string; readonly data: Blob };

interface Part {
  readonly path: string;
  readonly data: Blob;
}

/** Of a picked folder the paths below it. INVALID_ARGUMENT naming `field` where there is nothing to send. */
export function partsOf(field: string, files: readonly PageFile[]): Part[] {
  if (!Array.isArray(files) || files.length === 0) throw badArgument(field, "needs one file or more");
  return files.map((file: PageFile, i) => {
    if (file instanceof File) {
      return { path: file.webkitRelativePath.split("/").slice(1).join("/") || file.name, data: file };
    }
    if (typeof file?.path !== "string" || file.path === "" || !(file.data instanceof Blob)) {
      throw badArgument(`${field}[${i}]`, "must be a File, or { path, data } with a Blob");
    }
    if (file.path.split("/").some((name) => name === "" || name === "." || name === "..")) {
      throw badArgument(`${field}[${i}]`, `path ${JSON.stringify(file.path)} must be relative, and stay in its folder`);
    }
    return { path: file.path, data: file.data };
  });
}

/** What an answer that is none of success says, as the dashboard words it. */
export function failureOf(status: number, body: string, what: string, field?: string): GroundlockError {
  let told: { code?: string; message?: string } = {};
  try {
    told = JSON.parse(body) as typeof told;
  } catch {
    // Not ours: a gateway's page.
  }
  const code = Code[(told.code ?? "UNKNOWN") as keyof typeof Code] ?? Code.UNKNOWN;
  return new GroundlockError(code, told.message ?? `${what} was answered by ${status}`, field);
}

/** Sends files one after the other; resolves to the upload's id. If one fails, or
 * `onProgress` throws, or `signal` says so, what was begun is removed again. */
export async function upload(
  url: URL, kind: "video" | "map", name: string, parts: readonly Part[],
  onProgress: OnProgress | undefined, signal: AbortSignal | undefined,
): Promise<string> {
  const made = await request("POST", new URL("/api/uploads", url), JSON.stringify({ kind, name }), undefined, signal);
  const { upload_id: id } = JSON.parse(made) as { upload_id: string };
  const place = `/api/uploads/${encodeURIComponent(id)}`;
  const bytesTotal = parts.reduce((sum, part) => sum + part.data.size, 0);
  let before = 0;
  const tell = (sent: number, note: string): void => {
    const bytesDone = before + sent;
    onProgress?.({ stage: "uploading", fraction: bytesTotal > 0 ? bytesDone / bytesTotal : 1, note, bytesDone, bytesTotal });
  };
  try {
    for (const { path, data } of parts) {
      const encoded = path.split("/").map(encodeURIComponent).join("/");
      await request("PUT", new URL(`${place}/${encoded}`, url), data, (sent) => tell(sent, path), signal);
      before += data.size;
    }
    return id;
  } catch (error) {
    await request("DELETE", new URL(place, url)).catch(() => undefined);
    throw error;
  }
}

// fetch() tells nothing of the bytes on their way; XMLHttpRequest does.
function request(
  method: string, url: URL, body?: string | Blob, onSent?: (bytes: number) => void, signal?: AbortSignal,
): Promise<string> {
  return new Promise((resolve, reject) => {
    const call = new XMLHttpRequest();
    let thrown: { error: unknown } | undefined;
    const abort = (): void => call.abort();
    if (signal?.aborted) {
      reject(new GroundlockError(Code.CANCELLED, "the upload was cancelled"));
      return;
    }
    signal?.addEventListener("abort", abort, { once: true });
    call.open(method, url);
    call.setRequestHeader("Content-Type", typeof body === "string" ? "application/json" : "application/octet-stream");
    if (onSent) {
      call.upload.onprogress = ({ loaded }) => {
        try {
          onSent(loaded);
        } catch (error) {
          thrown = { error };
          call.abort();
        }
      };
    }
    call.onabort = () => reject(thrown ? thrown.error : new GroundlockError(Code.CANCELLED, "the upload was cancelled"));
    call.onerror = () => reject(new GroundlockError(Code.UNAVAILABLE, `${url.origin}: the connection broke during the upload`));
    call.onload = () => {
      if (call.status >= 200 && call.status < 300) resolve(call.responseText);
      else reject(failureOf(call.status, call.responseText, "the upload"));
    };
    call.onloadend = () => signal?.removeEventListener("abort", abort);
    call.send(body ?? null);
  });
}
