// SPDX-License-Identifier: Apache-2.0
// How the client connects.
import { readFileSync } from "node:fs";
import * as grpc from "@grpc/grpc-js";
import { type DescMethod, type DescMessage, type MessageShape, fromBinary, toBinary } from "@bufbuild/protobuf";
import { aboveZero } from "./checks.js";
import { Code, GroundlockError, badArgument, errorOfCall, show } from "./errors.js";

export const DEFAULT_PORT = 50551;

/** Encryption; files are PEM. */
export interface TlsOptions {
  /** What the server's certificate is checked against; left out = the system's authorities. */
  readonly ca?: string;
  /** This client's own certificate and key, for servers that want one. */
  readonly cert?: string;
  readonly key?: string;
  /** The name in the server's certificate, where it is not the host. */
  readonly serverName?: string;
}

export interface ConnectOptions {
  /** Sent along with every call; over the network as it is, unless `tls` is given. */
  readonly token?: string;
  /** File whose first line is the token; without either, the environment's GROUNDLOCK_TOKEN. */
  readonly tokenFile?: string;
  readonly tls?: TlsOptions;
  /** How long to wait for the server; left out = 5000. */
  readonly connectTimeoutMs?: number;
  /** Deadline of quick calls; left out = 30000. */
  readonly callTimeoutMs?: number;
  /** Largest message taken from the server; left out = 64 MiB. */
  readonly maxMessageBytes?: number;
}

function pem(field: string, path: string | undefined): Buffer | null {
  if (path === undefined) return null;
  let content: Buffer;
  try {
    content = readFileSync(path);
  } catch (error) {
    throw badArgument(field, `${path}: cannot be read: ${(error as Error).message}`);
  }
  if (!content.includes("-----BEGIN ")) throw badArgument(field, `${path}: is not a PEM file`);
  return content;
}

function credentials(tls: TlsOptions | undefined): grpc.ChannelCredentials {
  if (tls === undefined) return grpc.credentials.createInsecure();
  if ((tls.cert === undefined) !== (tls.key === undefined)) {
    const missing = tls.key === undefined ? "tls.key" : "tls.cert";
    throw badArgument(missing, "is missing: tls.cert and tls.key go together");
  }
  return grpc.credentials.createSsl(pem("tls.ca", tls.ca), pem("tls.key", tls.key), pem("tls.cert", tls.cert));
}

function findToken(options: ConnectOptions): string | undefined {
  if (options.token !== undefined) {
    if (!/^[\x21-\x7e]+$/.test(options.token)) throw badArgument("token", "must be printable ASCII characters");
    return options.token;
  }
  if (options.tokenFile === undefined) return process.env["GROUNDLOCK_TOKEN"] || undefined;
  let text: string;
  try {
    text = readFileSync(options.tokenFile, "utf8");
  } catch (error) {
    throw badArgument("tokenFile", `${options.tokenFile}: cannot be read: ${(error as Error).message}`);
  }
  const token = text.split("\n")[0]?.trim();
  if (!token) throw badArgument("tokenFile", `${options.tokenFile}: its first line holds no token`);
  return token;
}

/** HOST:PORT; grpcs:// before it turns TLS on. */
function checkServer(server: string): { target: string; secure: boolean } {
  const [, scheme, target = ""] = /^(grpcs?:\/\/)?(.*)$/.exec(String(server)) ?? [];
  const secure = scheme === "grpcs://";
  if (target.startsWith("unix:")) return { target, secure };
  const match = /^([^/]+):(\d+)$/.exec(target);
  const port = Number(match?.[2]);
  if (!match || port < 1 || port > 65535) {
    throw badArgument("server", `${show(server)} must be HOST:PORT, or grpcs://HOST:PORT for TLS`);
  }
  return { target, secure };
}

type Method<I extends DescMessage, O extends DescMessage> = DescMethod & { input: I; output: O };
type Kind<K extends DescMethod["methodKind"]> = { methodKind: K };

/** One connection; its methods are gRPC's calls with the token on them. */
export class Channel {
  readonly server: string;
  readonly callTimeoutMs: number;
  readonly #client: grpc.Client;
  readonly #connectTimeoutMs: number;
  readonly #metadata = new grpc.Metadata();

  constructor(server: string, options: ConnectOptions) {
    const { target, secure } = checkServer(server);
    const tls = options.tls ?? (secure ? {} : undefined);
    this.server = target;
    this.#connectTimeoutMs = aboveZero("connectTimeoutMs", options.connectTimeoutMs ?? 5_000);
    this.callTimeoutMs = aboveZero("callTimeoutMs", options.callTimeoutMs ?? 30_000);
    const token = findToken(options);
    // gRPC's own call credentials would want TLS, which ends at a proxy where
    // there is one.
    if (token !== undefined) this.#metadata.set("authorization", `Bearer ${token}`);
    const channelOptions: grpc.ClientOptions = {
      "grpc.max_receive_message_length": aboveZero("maxMessageBytes", options.maxMessageBytes ?? 64 << 20),
      "grpc.max_send_message_length": -1, // the server knows its own limit
      "grpc.keepalive_time_ms": 20_000,
      "grpc.keepalive_timeout_ms": 10_000,
      // Streams reconnect by themselves and sooner than gRPC's default allows.
      "grpc.initial_reconnect_backoff_ms": 100,
      "grpc.max_reconnect_backoff_ms": 5_000,
      // Clients in one process do not share a connection behind our back.
      "grpc.use_local_subchannel_pool": 1,
      ...(tls?.serverName ? { "grpc.ssl_target_name_override": tls.serverName } : {}),
    };
    this.#client = new grpc.Client(target, credentials(tls), channelOptions);
  }

  /** UNAVAILABLE if nobody answers in time; any answer tells that the server is there. */
  async ready(): Promise<void> {
    for (const waitForReady of [true, false]) {
      const metadata = this.#metadata.clone();
      metadata.setOptions({ waitForReady });
      const error = await new Promise<grpc.ServiceError | null>((resolve) => {
        this.#client.makeUnaryRequest(
          "/grpc.health.v1.Health/Check",
          (bytes: Buffer) => bytes,
          (bytes: Buffer) => bytes,
          Buffer.alloc(0),
          metadata,
          { deadline: Date.now() + this.#connectTimeoutMs },
          (failed) => resolve(failed),
        );
      });
      if (error === null) return;
      if (error.code !== grpc.status.DEADLINE_EXCEEDED && error.code !== grpc.status.UNAVAILABLE) return;
      // The second time tells why there is no connection.
      if (!waitForReady) throw new GroundlockError(Code.UNAVAILABLE, errorOfCall(error, this.server).message);
    }
  }

  close(): void {
    this.#client.close();
  }

  #path(method: DescMethod): string {
    return `/${method.parent.typeName}/${method.name}`;
  }

  unary<I extends DescMessage, O extends DescMessage>(
    method: Method<I, O> & Kind<"unary">,
    request: MessageShape<I>,
    quick = true,
    signal?: AbortSignal,
  ): Promise<MessageShape<O>> {
    return new Promise((resolve, reject) => {
      const call = this.#client.makeUnaryRequest(
        this.#path(method),
        serialize(method.input),
        deserialize(method.output),
        request,
        this.#metadata.clone(),
        quick ? { deadline: Date.now() + this.callTimeoutMs } : {},
        (error, response) => (error ? reject(errorOfCall(error, this.server)) : resolve(response as MessageShape<O>)),
      );
      signal?.addEventListener("abort", () => call.cancel());
    });
  }

  serverStream<I extends DescMessage, O extends DescMessage>(
    method: Method<I, O> & Kind<"server_streaming">,
    request: MessageShape<I>,
  ): grpc.ClientReadableStream<MessageShape<O>> {
    return this.#client.makeServerStreamRequest(
      this.#path(method), serialize(method.input), deserialize(method.output), request, this.#metadata.clone(),
    );
  }

  clientStream<I extends DescMessage, O extends DescMessage>(
    method: Method<I, O> & Kind<"client_streaming">,
    done: (error: GroundlockError | null, response: MessageShape<O> | undefined) => void,
  ): grpc.ClientWritableStream<MessageShape<I>> {
    return this.#client.makeClientStreamRequest(
      this.#path(method), serialize(method.input), deserialize(method.output), this.#metadata.clone(),
      (error, response) => done(error && errorOfCall(error, this.server), response),
    );
  }

  duplex<I extends DescMessage, O extends DescMessage>(
    method: Method<I, O> & Kind<"bidi_streaming">,
  ): grpc.ClientDuplexStream<MessageShape<I>, MessageShape<O>> {
    return this.#client.makeBidiStreamRequest(
      this.#path(method), serialize(method.input), deserialize(method.output), this.#metadata.clone(),
    );
  }
}

function serialize<D extends DescMessage>(schema: D): (message: MessageShape<D>) => Buffer {
  return (message) => Buffer.from(toBinary(schema, message));
}
function deserialize<D extends DescMessage>(schema: D): (bytes: Buffer) => MessageShape<D> {
  return (bytes) => fromBinary(schema, bytes);
}
