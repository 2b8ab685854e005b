// SPDX-License-Identifier: Apache-2.0
// The WebSocket to the dashboard's proxy: requests with replies, pushed
// messages, reconnection with growing pauses, and the proxy's clock.
import { create, fromBinary, toBinary, type MessageInitShape } from "@bufbuild/protobuf";
import {
  ClientMessageSchema,
  ServerMessageSchema,
  type ServerMessage,
} from "../gen/groundlock/dashboard/v1/dashboard_pb";
import { ClockOffset } from "./clock_offset";

export type RequestInit = NonNullable<MessageInitShape<typeof ClientMessageSchema>["request"]>;
export type Reply = ServerMessage["message"];
export type ReplyCase = NonNullable<Reply["case"]>;
export type ReplyValue<C extends ReplyCase> = Extract<Reply, { case: C }>["value"];

export type LinkState = "connecting" | "open" | "waiting" | "refused";

export class RequestError extends Error {
  constructor(readonly code: number, message: string) {
    super(message);
  }
}

export interface LinkEvents {
  onState(state: LinkState, retryAtMs: number): void;
  onPushed(message: ServerMessage): void;
}

const FIRST_PAUSE_MS = 300;
const MAX_PAUSE_MS = 5_000;
const PING_EVERY_MS = 2_000;
// Without a sign of life for so long, the connection is taken for dead.
const SILENCE_MS = 8_000;
const CLOSED_BY_POLICY = 1008;

interface Waiting {
  resolve(reply: Reply): void;
  reject(error: Error): void;
  onProgress?: (reply: Reply) => void;
}

export class Connection {
  readonly clock = new ClockOffset();
  private socket: WebSocket | null = null;
  private nextId = 1n;
  private readonly waiting = new Map<bigint, Waiting>();
  private pause = FIRST_PAUSE_MS;
  private retry: ReturnType<typeof setTimeout> | undefined;
  private heartbeat: ReturnType<typeof setInterval> | undefined;
  private heard = 0;
  private stopped = true;

  constructor(
    private readonly url: string,
    private readonly events: LinkEvents,
  ) {}

  start(): void {
    if (!this.stopped) return;
    this.stopped = false;
    this.open();
  }

  stop(): void {
    this.stopped = true;
    clearTimeout(this.retry);
    this.socket?.close();
    this.drop("the page was left");
  }

  // Tries at once instead of after the pause.
  retryNow(): void {
    if (this.stopped || this.socket) return;
    clearTimeout(this.retry);
    this.open();
  }

  // Sends a request and returns its reply's value. Rejects with RequestError if
  // the reply is an error, or another one than `expected`, or never comes.
  async request<C extends ReplyCase>(
    expected: C,
    request: RequestInit,
    onProgress?: (stage: string, fraction: number, note: string) => void,
  ): Promise<ReplyValue<C>> {
    const { reply } = this.send(request, onProgress);
    const answer = await reply;
    if (answer.case === "error") throw new RequestError(answer.value.code, answer.value.message);
    if (answer.case !== expected) {
      throw new RequestError(13, `unexpected reply '${answer.case}' to '${request.case}'`);
    }
    return answer.value as ReplyValue<C>;
  }

  // The same, with the request's id (to cancel it).
  send(
    request: RequestInit,
    onProgress?: (stage: string, fraction: number, note: string) => void,
  ): { id: bigint; reply: Promise<Reply> } {
    const id = this.nextId++;
    const reply = new Promise<Reply>((resolve, reject) => {
      if (this.socket?.readyState !== WebSocket.OPEN) {
        reject(new RequestError(14, "not connected to the dashboard; trying again"));
        return;
      }
      const waiting: Waiting = { resolve, reject };
      if (onProgress) {
        waiting.onProgress = (r) => {
          if (r.case === "progress") onProgress(r.value.stage, r.value.fraction, r.value.note);
        };
      }
      this.waiting.set(id, waiting);
      const message = create(ClientMessageSchema, { requestId: id, request });
      this.socket.send(toBinary(ClientMessageSchema, message));
    });
    return { id, reply };
  }

  // Sends what has no reply.
  tell(request: RequestInit): void {
    if (this.socket?.readyState !== WebSocket.OPEN) return;
    this.socket.send(toBinary(ClientMessageSchema, create(ClientMessageSchema, { request })));
  }

  private open(): void {
    this.events.onState("connecting", 0);
    const socket = new WebSocket(this.url);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    this.heard = performance.now();
    socket.onopen = () => {
      this.pause = FIRST_PAUSE_MS;
      this.heard = performance.now();
      this.events.onState("open", 0);
      this.ping();
    };
    socket.onmessage = (event: MessageEvent<ArrayBuffer>) => this.receive(event.data);
    socket.onclose = (event) => {
      if (this.socket !== socket) return;
      this.socket = null;
      clearInterval(this.heartbeat);
      this.drop("the connection to the dashboard broke");
      if (this.stopped) return;
      const retryAt = performance.now() + this.pause;
      this.retry = setTimeout(() => this.open(), this.pause);
      this.pause = Math.min(2 * this.pause, MAX_PAUSE_MS);
      this.events.onState(event.code === CLOSED_BY_POLICY ? "refused" : "waiting", retryAt);
    };
    clearInterval(this.heartbeat);
    this.heartbeat = setInterval(() => {
      if (performance.now() - this.heard > SILENCE_MS) socket.close();
      else if (socket.readyState === WebSocket.OPEN) this.ping();
    }, PING_EVERY_MS);
  }

  private ping(): void {
    this.request("pong", { case: "ping", value: { clientTimeMs: performance.now() } })
      .then((pong) => {
        this.clock.add(pong.clientTimeMs, performance.now(), Number(pong.serverTimeNs) / 1e6);
      })
      .catch(() => undefined); // a broken connection is told by onclose
  }

  private receive(data: ArrayBuffer): void {
    this.heard = performance.now();
    let message: ServerMessage;
    try {
      message = fromBinary(ServerMessageSchema, new Uint8Array(data));
    } catch {
      this.socket?.close(); // not ours, or another version: start anew
      return;
    }
    const waiting = message.requestId > 0n ? this.waiting.get(message.requestId) : undefined;
    if (!waiting) {
      this.events.onPushed(message);
    } else if (message.message.case === "progress") {
      waiting.onProgress?.(message.message);
    } else {
      this.waiting.delete(message.requestId);
      waiting.resolve(message.message);
    }
  }

  private drop(reason: string): void {
    const all = [...this.waiting.values()];
    this.waiting.clear();
    for (const w of all) w.reject(new RequestError(14, reason));
  }
}
