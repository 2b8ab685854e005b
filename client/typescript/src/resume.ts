// SPDX-License-Identifier: Apache-2.0
// What a stream of frames knows across broken connections: which frames have no
// answer yet, which of them are on their way, and how to go on. No sockets: the
// stream drives it. The rules are those of docs/api.md, "Resuming", as the C++
// client keeps them.
import { create } from "@bufbuild/protobuf";
import { aboveZero, finite, identifier, whole } from "./checks.js";
import { answerFrom, frameTo } from "./convert.js";
import { Code, GroundlockError, badArgument } from "./errors.js";
import {
  TrackRequestSchema, TrackRequest_AttachSchema, type TrackRequest, type TrackResponse,
} from "./gen/groundlock/v1/tracking_pb.js";
import type { Answer, Frame } from "./types.js";

const UINT64_MAX = (1n << 64n) - 1n;

// After these another attempt could bring something else.
const TRANSIENT: ReadonlySet<Code> = new Set<Code>([
  Code.UNAVAILABLE, Code.CANCELLED, Code.UNKNOWN, Code.INTERNAL, Code.DEADLINE_EXCEEDED,
]);

export interface StreamOptions {
  /** Frames that may be on the way: sent, and their answer not yet taken; send()
   * waits when it is reached. Left out = 16, at most 256. */
  readonly maxInFlight?: number;
  /** Waits between attempts to connect again grow from the first to the last. */
  readonly firstBackoffMs?: number; // left out = 100
  readonly lastBackoffMs?: number; // left out = 5000
  /** The stream gives up when it could not be restored for so long. */
  readonly giveUpAfterMs?: number; // left out = 60000
}

export class ResumableFrames {
  readonly answers: Answer[] = []; // not yet taken by the caller
  numReconnects = 0;
  attachedOnce = false;
  closed = false; // no more frames will come
  over = false;
  error: GroundlockError | undefined; // why it is over
  firstSequence = 0;
  readonly #sessionId: string;
  readonly #maxInFlight: number;
  readonly #firstBackoffMs: number;
  readonly #lastBackoffMs: number;
  readonly #giveUpAfterMs: number;
  #nextSequence = 0;
  // Without an answer, in order; the first #numWritten are on their way on the
  // present connection, or with the server since an earlier one.
  #unanswered: { sequence: number; message: TrackRequest }[] = [];
  #numWritten = 0;
  #connected = false;
  #attempt = 0;
  #giveUpAt: number;
  #lastError = new GroundlockError(Code.UNAVAILABLE, "not connected yet");

  constructor(sessionId: string, options: StreamOptions) {
    this.#sessionId = identifier("sessionId", sessionId);
    // The server keeps 256 answers to be sent again.
    this.#maxInFlight = whole("maxInFlight", options.maxInFlight ?? 16, 1, 256);
    this.#firstBackoffMs = aboveZero("firstBackoffMs", options.firstBackoffMs ?? 100);
    this.#lastBackoffMs = finite("lastBackoffMs", options.lastBackoffMs ?? Math.max(5_000, this.#firstBackoffMs));
    if (this.#lastBackoffMs < this.#firstBackoffMs) {
      throw badArgument("lastBackoffMs", `${this.#lastBackoffMs} must not be below firstBackoffMs, ${this.#firstBackoffMs}`);
    }
    this.#giveUpAfterMs = finite("giveUpAfterMs", options.giveUpAfterMs ?? 60_000);
    if (this.#giveUpAfterMs < 0) throw badArgument("giveUpAfterMs", `${this.#giveUpAfterMs} must not be negative`);
    this.#giveUpAt = performance.now() + this.#giveUpAfterMs;
  }

  // --- the caller's side

  get inFlight(): number {
    return this.#unanswered.length + this.answers.length;
  }
  get hasRoom(): boolean {
    return this.inFlight < this.#maxInFlight;
  }

  /** Throws why no frame can be sent any more. */
  checkOpen(): void {
    if (this.over) {
      throw this.error ?? new GroundlockError(Code.FAILED_PRECONDITION, "the stream has ended");
    }
    if (this.closed) throw new GroundlockError(Code.FAILED_PRECONDITION, "frames were declared complete");
  }

  /** Checks and numbers a frame; says nothing about room. */
  prepare(frame: Frame): { sequence: number; message: TrackRequest } {
    const sequence = whole("frame.sequence", frame.sequence ?? this.#nextSequence);
    if (sequence < this.#nextSequence) {
      throw badArgument("frame.sequence", `${sequence} is below ${this.#nextSequence}, the next that may be sent`);
    }
    return { sequence, message: frameTo(frame, sequence) };
  }

  push(prepared: { sequence: number; message: TrackRequest }): void {
    this.#nextSequence = prepared.sequence + 1;
    this.#unanswered.push(prepared);
  }

  // --- the connection's side

  /** The first message of a connection. */
  attachRequest(): TrackRequest {
    const first = this.#unanswered[0];
    const value = create(TrackRequest_AttachSchema, {
      sessionId: this.#sessionId,
      // Answers to an earlier client's frames are not ours to deliver.
      resumeFrom: first ? BigInt(first.sequence) : this.attachedOnce ? BigInt(this.#nextSequence) : UINT64_MAX,
    });
    return create(TrackRequestSchema, { message: { case: "attach", value } });
  }

  /** Takes the first response of a connection. */
  attached(response: TrackResponse): void {
    if (response.message.case !== "attached") {
      throw new GroundlockError(Code.UNIMPLEMENTED, "the server did not say that it is attached");
    }
    const expected = Number(response.message.value.nextSequence);
    if (this.attachedOnce) {
      ++this.numReconnects;
    } else {
      this.attachedOnce = true;
      this.firstSequence = this.#nextSequence = expected;
    }
    // Frames that have arrived before are not sent again.
    this.#numWritten = this.#unanswered.filter((f) => f.sequence < expected).length;
    this.#connected = true;
  }

  get canWrite(): boolean {
    return this.#numWritten < this.#unanswered.length;
  }

  /** Counted before it is written: its answer may be there sooner. */
  nextToWrite(): TrackRequest | undefined {
    const next = this.#unanswered[this.#numWritten];
    if (next) ++this.#numWritten;
    return next?.message;
  }

  /** Takes an answer off the connection, for the caller. */
  take(response: TrackResponse): void {
    const answer = answerFrom(response);
    for (;;) {
      const first = this.#unanswered[0];
      if (!first || this.#numWritten === 0 || first.sequence > answer.sequence) return;
      this.#unanswered.shift();
      --this.#numWritten;
      if (first.sequence === answer.sequence) {
        this.answers.push(answer);
        return;
      }
      // Answers come in order, so this one will not come any more.
      this.#lost(first.sequence);
    }
  }

  /** The connection is over, in good order or by an error: true if the stream is
   * to be connected again. */
  endOfConnection(ended: GroundlockError | undefined): boolean {
    if (this.#connected) {
      // The time without a connection begins now, however long it held.
      this.#connected = false;
      this.#attempt = 0;
      this.#giveUpAt = performance.now() + this.#giveUpAfterMs;
    }
    if (this.over) return false;
    if (ended === undefined && this.closed && !this.canWrite) {
      // It ended too early: answers that were not sent are lost.
      for (const { sequence } of this.#unanswered) this.#lost(sequence);
      this.#unanswered = [];
      this.#numWritten = 0;
      this.end(undefined);
      return false;
    }
    const error = ended ?? new GroundlockError(Code.UNAVAILABLE, "the server ended the stream");
    // The first connection is the caller's to repeat.
    if (!this.attachedOnce || !TRANSIENT.has(error.code)) {
      this.end(error);
      return false;
    }
    this.#lastError = error;
    return true;
  }

  /** How long to wait before the next attempt; undefined: it is given up. */
  backoffMs(): number | undefined {
    const wait = Math.min(this.#firstBackoffMs * 2 ** Math.min(this.#attempt++, 16), this.#lastBackoffMs);
    if (performance.now() + wait <= this.#giveUpAt) return wait;
    const why = `the connection was lost and could not be restored: ${this.#lastError.message}`;
    this.end(new GroundlockError(Code.UNAVAILABLE, why));
    return undefined;
  }

  end(error: GroundlockError | undefined): void {
    if (this.over) return;
    this.over = true;
    this.error = error;
  }

  #lost(sequence: number): void {
    const error = new GroundlockError(Code.DATA_LOSS, "the server no longer has the answer");
    this.answers.push({ kind: "failed", sequence, error });
  }
}
