// SPDX-License-Identifier: Apache-2.0
// A file on the dashboard, read in pieces by HTTP range requests. Pieces are
// kept, newest first, up to a bound.

const MAX_CACHE_BYTES = 64 << 20;

export class HttpReadable {
  failed = false; // the last request did not succeed
  private length = 0n;
  private readonly cache = new Map<string, Uint8Array>();
  private cached = 0;

  constructor(
    private readonly url: string,
    private readonly signal: AbortSignal,
  ) {}

  async open(): Promise<void> {
    const response = await this.fetch("bytes=0-7");
    const total = /\/(\d+)$/.exec(response.headers.get("Content-Range") ?? "");
    if (response.status !== 206 || !total) {
      this.failed = true;
      throw new Error("the dashboard does not serve parts of recordings");
    }
    await response.arrayBuffer();
    this.length = BigInt(total[1]!);
  }

  async size(): Promise<bigint> {
    return this.length;
  }

  async read(offset: bigint, size: bigint): Promise<Uint8Array> {
    if (size === 0n) return new Uint8Array(0);
    if (offset < 0n || offset + size > this.length) {
      throw new Error(`the recording ends at byte ${this.length}, asked for ${offset + size}`);
    }
    const key = `${offset}+${size}`;
    const kept = this.cache.get(key);
    if (kept) {
      this.cache.delete(key);
      this.cache.set(key, kept);
      return kept;
    }
    const response = await this.fetch(`bytes=${offset}-${offset + size - 1n}`);
    const data = new Uint8Array(await response.arrayBuffer());
    if (BigInt(data.byteLength) !== size) {
      throw new Error(`got ${data.byteLength} bytes of the recording instead of ${size}`);
    }
    this.keep(key, data);
    return data;
  }

  private keep(key: string, data: Uint8Array): void {
    if (data.byteLength > MAX_CACHE_BYTES / 2) return;
    this.cache.set(key, data);
    this.cached += data.byteLength;
    for (const [oldest, bytes] of this.cache) {
      if (this.cached <= MAX_CACHE_BYTES) break;
      this.cache.delete(oldest);
      this.cached -= bytes.byteLength;
    }
  }

  private async fetch(range: string): Promise<Response> {
    const response = await fetch(this.url, { headers: { Range: range }, signal: this.signal });
    this.failed = !response.ok;
    if (response.status === 404) throw new Error("there is no such recording");
    if (response.status === 401) throw new Error("log in to read recordings");
    if (!response.ok) throw new Error(`the dashboard answered ${response.status}`);
    return response;
  }
}
