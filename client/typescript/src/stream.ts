// SPDX-License-Identifier: Apache-2.0
// Frames out, answers in; and the watching of others' sessions.
import { once } from "node:events";
import type * as grpc from "@grpc/grpc-js";
import type { Channel } from "./channel.js";
import { watchFrom } from "./convert.js";
import { Code, GroundlockError, errorOfCall } from "./errors.js";
import { TrackingService, type TrackRequest, type TrackResponse, type WatchSessionResponse } from "./gen/groundlock/v1/tracking_pb.js";
import { ResumableFrames, type StreamOptions } from "./resume.js";
import type { Answer, Frame, WatchUpdate } from "./types.js";

export type Frames = AsyncIterable<Frame> | Iterable<Frame>;
type Call = grpc.ClientDuplexStream<TrackRequest, TrackResponse>;

/** Sends frames to a session and receives their answers: one for every frame, in
 * the order of the frames, across broken connections. After a break it
 * reconnects with back-off, learns from the server which frames have arrived,
 * has the answers that got lost on the way sent again and sends the frames that
 * did not arrive once more. Made by Session.stream(). */
export class TrackingStream implements AsyncIterable<Answer> {
  readonly #channel: Channel;
  readonly #frames: ResumableFrames;
  #call: Call | undefined;
  #cancelled = false;
  #waiters = new Set<() => void>();
  readonly #running: Promise<void>;

  private constructor(channel: Channel, sessionId: string, options: StreamOptions) {
    this.#channel = channel;
    this.#frames = new ResumableFrames(sessionId, options);
    this.#running = this.#run();
  }

  /** Made by Session.stream(). */
  static async open(channel: Channel, sessionId: string, options: StreamOptions): Promise<TrackingStream> {
    const stream = new TrackingStream(channel, sessionId, options);
    await stream.#until(() => stream.#frames.attachedOnce || stream.#frames.over);
    if (!stream.#frames.attachedOnce && stream.#frames.error) throw stream.#frames.error;
    return stream;
  }

  /** The first sequence number that the server takes, as it said when the stream
   * was opened: a client that was killed goes on from there. */
  get nextSequence(): number {
    return this.#frames.firstSequence;
  }
  /** How often the connection was lost and restored. */
  get numReconnects(): number {
    return this.#frames.numReconnects;
  }
  /** Frames sent whose answer has not been taken. */
  get inFlight(): number {
    return this.#frames.inFlight;
  }

  /** Hands over a frame; waits while maxInFlight are on the way. Resolves to its
   * sequence number. One at a time: await it before the next.
   * DEADLINE_EXCEEDED: there was no room in time, and the frame was not taken.
   * Otherwise the reason for which the stream has ended (NOT_FOUND: the session
   * is gone; ABORTED: another stream took over; UNAVAILABLE: it could not be
   * restored). */
  async send(frame: Frame, options: { readonly timeoutMs?: number } = {}): Promise<number> {
    const frames = this.#frames;
    const prepared = frames.prepare(frame);
    if (!(await this.#until(() => frames.over || frames.closed || frames.hasRoom, options.timeoutMs))) {
      throw new GroundlockError(
        Code.DEADLINE_EXCEEDED,
        `frame ${prepared.sequence}: ${frames.inFlight} frames are on the way already; take their answers`,
      );
    }
    frames.checkOpen();
    frames.push(prepared);
    this.#changed();
    return prepared.sequence;
  }

  /** No more frames; receiving goes on with the outstanding answers. */
  closeSend(): void {
    this.#frames.closed = true;
    this.#changed();
  }

  /** The next answer; undefined after closeSend() and the last one.
   * DEADLINE_EXCEEDED: none came in time, and the stream goes on. */
  async receive(options: { readonly timeoutMs?: number } = {}): Promise<Answer | undefined> {
    const frames = this.#frames;
    const ready = await this.#until(() => frames.over || frames.answers.length > 0, options.timeoutMs);
    const answer = frames.answers.shift();
    if (answer) {
      this.#changed(); // there is room again
      return answer;
    }
    if (!ready) throw new GroundlockError(Code.DEADLINE_EXCEEDED, "no answer came in time");
    if (frames.error) throw frames.error;
    return undefined;
  }

  /** The answers, until closeSend() and the last one. */
  async *[Symbol.asyncIterator](): AsyncGenerator<Answer> {
    for (let answer; (answer = await this.receive()); ) yield answer;
  }

  /** Sends the frames and yields the answers as they come. What `frames` throws
   * is thrown after the answers to the frames before it. Leaving the loop early
   * ends the stream. */
  async *process(frames: Frames): AsyncGenerator<Answer> {
    let failure: { error: unknown } | undefined;
    let stopped = false;
    const feed = async (): Promise<void> => {
      try {
        for await (const frame of frames) {
          if (stopped) return;
          await this.send(frame);
        }
      } catch (error) {
        failure = { error };
      } finally {
        this.closeSend();
      }
    };
    void feed();
    let done = false;
    try {
      yield* this;
      done = true;
    } finally {
      stopped = true;
      if (!done) await this.cancel();
    }
    if (failure) throw failure.error;
  }

  /** Ends the stream at once; who waits gets CANCELLED. The session stays. */
  async cancel(): Promise<void> {
    this.#cancelled = true;
    this.#frames.end(new GroundlockError(Code.CANCELLED, "the stream was cancelled"));
    this.#call?.cancel();
    this.#changed();
    await this.#running;
  }

  // --- the connection

  #changed(): void {
    for (const waiter of [...this.#waiters]) waiter();
  }

  /** False: it did not become true in time. */
  #until(predicate: () => boolean, timeoutMs?: number): Promise<boolean> {
    if (predicate()) return Promise.resolve(true);
    return new Promise((resolve) => {
      let timer: NodeJS.Timeout | undefined;
      const finish = (result: boolean): void => {
        clearTimeout(timer);
        this.#waiters.delete(check);
        resolve(result);
      };
      const check = (): void => {
        if (predicate()) finish(true);
      };
      if (timeoutMs !== undefined) timer = setTimeout(() => finish(predicate()), timeoutMs);
      this.#waiters.add(check);
    });
  }

  async #run(): Promise<void> {
    for (;;) {
      const error = await this.#connect();
      if (!this.#frames.endOfConnection(error)) break;
      const wait = this.#frames.backoffMs();
      if (wait === undefined) break;
      await this.#until(() => this.#cancelled, wait);
    }
    this.#changed();
  }

  /** One connection, from attaching to its end; what it ended with. */
  async #connect(): Promise<GroundlockError | undefined> {
    if (this.#cancelled) return undefined;
    const frames = this.#frames;
    const call = this.#channel.duplex(TrackingService.method.track);
    this.#call = call;
    let over = false;
    let attached = false;
    const ended = new Promise<GroundlockError | undefined>((resolve) => {
      call.on("error", (error) => resolve(errorOfCall(error, this.#channel.server)));
      call.on("status", (status) => {
        if (status.code === Code.OK) {
          const lost = new GroundlockError(Code.UNAVAILABLE, "the connection was lost");
          resolve(attached ? undefined : lost);
        }
      });
    });
    call.on("data", (response: TrackResponse) => {
      if (over) return;
      try {
        if (attached) {
          frames.take(response);
        } else {
          frames.attached(response);
          attached = true;
          void this.#write(call, () => over);
        }
      } catch (error) {
        // The server speaks what is not understood here; it would again.
        frames.end(errorOfCall(error as Error, this.#channel.server));
        call.cancel();
      }
      this.#changed();
    });
    call.write(frames.attachRequest());
    const error = await ended;
    over = true;
    this.#changed(); // the writer
    return error;
  }

  async #write(call: Call, over: () => boolean): Promise<void> {
    const frames = this.#frames;
    for (;;) {
      await this.#until(() => over() || frames.canWrite || frames.closed);
      if (over()) return;
      const message = frames.nextToWrite();
      if (message === undefined) {
        call.end();
        return;
      }
      // The network takes no more for now.
      if (!call.write(message)) {
        const drained = new AbortController();
        await Promise.race([
          once(call, "drain", { signal: drained.signal }).catch(() => undefined),
          this.#until(over),
        ]);
        drained.abort();
      }
    }
  }
}

/** Follows a session's results; made by Session.watch(). Ends when the session
 * does. It does not reconnect: open another. */
export class Watcher implements AsyncIterable<WatchUpdate> {
  readonly #call: grpc.ClientReadableStream<WatchSessionResponse>;
  readonly #server: string;
  #cancelled = false;

  private constructor(call: grpc.ClientReadableStream<WatchSessionResponse>, server: string) {
    this.#call = call;
    this.#server = server;
  }

  /** Made by Session.watch(). */
  static open(call: grpc.ClientReadableStream<WatchSessionResponse>, server: string): Promise<Watcher> {
    return new Promise((resolve, reject) => {
      const fail = (error: Error): void => reject(errorOfCall(error, server));
      call.once("error", fail);
      // Sent when the server watches; an error comes without.
      call.once("metadata", (metadata: grpc.Metadata) => {
        if (metadata.get("groundlock-watching").length === 0) return;
        call.off("error", fail);
        call.on("error", () => undefined); // the iterator gets it
        resolve(new Watcher(call, server));
      });
    });
  }

  async *[Symbol.asyncIterator](): AsyncGenerator<WatchUpdate> {
    try {
      for await (const message of this.#call) yield watchFrom(message as WatchSessionResponse);
    } catch (error) {
      const told = errorOfCall(error as Error, this.#server);
      // Deleted or expired: nothing is wrong with that.
      if (told.code === Code.NOT_FOUND) return;
      throw this.#cancelled ? new GroundlockError(Code.CANCELLED, "the watch was cancelled") : told;
    } finally {
      this.#call.cancel();
    }
  }

  cancel(): void {
    this.#cancelled = true;
    this.#call.cancel();
  }
}
