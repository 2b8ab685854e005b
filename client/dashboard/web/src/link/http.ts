// SPDX-License-Identifier: Apache-2.0
// The proxy's HTTP side: log-in and uploads.

export interface Info {
  version: string;
  server_state: "unknown" | "connected" | "unreachable";
  login_required: boolean | null;
  logged_in: boolean;
}

export class HttpError extends Error {
  constructor(readonly status: number, message: string) {
    super(message);
  }
}

// Relative: the dashboard may be served under a prefix.
const api = (path: string): string => new URL(`api/${path}`, document.baseURI).href;

export const webSocketUrl = (): string => {
  const url = new URL("ws", document.baseURI);
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  return url.href;
};

export const recordingUrl = (name: string): string => api(`recordings/${encodeURIComponent(name)}.mcap`);

async function failure(response: Response): Promise<HttpError> {
  let message = `the dashboard answered ${response.status}`;
  try {
    const body = (await response.json()) as { message?: string };
    if (body.message) message = body.message;
  } catch {
    // Not ours: a gateway's page.
  }
  return new HttpError(response.status, message);
}

export async function fetchInfo(): Promise<Info> {
  const response = await fetch(api("info"), { cache: "no-store" });
  if (!response.ok) throw await failure(response);
  return (await response.json()) as Info;
}

export async function logIn(token: string): Promise<void> {
  const response = await fetch(api("login"), {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify({ token }),
  });
  if (!response.ok) throw await failure(response);
}

export async function logOut(): Promise<void> {
  const response = await fetch(api("logout"), { method: "POST" });
  if (!response.ok) throw await failure(response);
}

export interface UploadFile {
  readonly path: string; // relative, '/'-separated
  readonly file: File;
}

// Uploads files one after the other; returns the upload's id. What was begun is
// removed again if it fails.
export async function upload(
  kind: "video" | "map",
  name: string,
  files: readonly UploadFile[],
  onProgress: (sentBytes: number, totalBytes: number, path: string) => void,
  signal: AbortSignal,
): Promise<string> {
  const response = await fetch(api("uploads"), {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify({ kind, name }),
    signal,
  });
  if (!response.ok) throw await failure(response);
  const { upload_id: id } = (await response.json()) as { upload_id: string };
  const total = files.reduce((sum, f) => sum + f.file.size, 0);
  let done = 0;
  try {
    for (const { path, file } of files) {
      const encoded = path.split("/").map(encodeURIComponent).join("/");
      await put(
        api(`uploads/${encodeURIComponent(id)}/${encoded}`),
        file,
        (sent) => onProgress(done + sent, total, path),
        signal,
      );
      done += file.size;
    }
  } catch (error) {
    await fetch(api(`uploads/${encodeURIComponent(id)}`), { method: "DELETE" }).catch(() => undefined);
    throw error;
  }
  return id;
}

// fetch() tells nothing about the bytes on their way; XMLHttpRequest does.
function put(url: string, body: Blob, onSent: (bytes: number) => void, signal: AbortSignal): Promise<void> {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    const abort = () => request.abort();
    signal.addEventListener("abort", abort, { once: true });
    request.open("PUT", url);
    request.setRequestHeader("Content-Type", "application/octet-stream");
    request.upload.onprogress = (event) => onSent(event.loaded);
    request.onabort = () => reject(new HttpError(0, "the upload was cancelled"));
    request.onerror = () => reject(new HttpError(0, "the connection broke during the upload"));
    request.onload = () => {
      if (request.status >= 200 && request.status < 300) return resolve();
      let message = `the dashboard answered ${request.status}`;
      try {
        message = (JSON.parse(request.responseText) as { message?: string }).message ?? message;
      } catch {
        // Not ours: a gateway's page.
      }
      reject(new HttpError(request.status, message));
    };
    request.onloadend = () => signal.removeEventListener("abort", abort);
    request.send(body);
  });
}
