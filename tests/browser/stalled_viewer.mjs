// SPDX-License-Identifier: Apache-2.0
// A viewer that subscribes and then takes nothing more from its socket.
import { createHash, randomBytes } from "node:crypto";
import { connect } from "node:net";

export class StalledViewer {
  constructor(port, cookie) {
    this.port = port;
    this.cookie = cookie;
    this.socket = null;
  }

  // ClientMessage { request_id: 1, subscribe { session_id, include_images } }.
  async subscribe(session) {
    this.socket = connect(this.port, "127.0.0.1");
    this.socket.on("error", () => undefined); // it may be thrown out
    const key = randomBytes(16).toString("base64");
    this.socket.write(
      `GET /ws HTTP/1.1\r\nHost: 127.0.0.1:${this.port}\r\nOrigin: http://127.0.0.1:${this.port}\r\nUpgrade: websocket\r\n` +
      `Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: ${key}\r\nCookie: ${this.cookie}\r\n\r\n`,
    );
    const head = await new Promise((resolve) => this.socket.once("data", (d) => resolve(d.toString("latin1"))));
    const accept = createHash("sha1").update(`${key}258EAFA5-E914-47DA-95CA-C5AB0DC85B11`).digest("base64");
    if (!head.includes(accept)) throw new Error(`no WebSocket: ${head.split("\r\n")[0]}`);
    const id = Buffer.from(session);
    const subscribe = Buffer.concat([Buffer.from([0x0a, id.length]), id, Buffer.from([0x10, 1])]);
    const message = Buffer.concat([Buffer.from([0x08, 1, 0x1a, subscribe.length]), subscribe]);
    const mask = randomBytes(4);
    this.socket.write(Buffer.concat([
      Buffer.from([0x82, 0x80 | message.length]), mask, Buffer.from(message.map((b, i) => b ^ mask[i % 4])),
    ]));
    await new Promise((resolve) => setTimeout(resolve, 200));
    this.socket.pause();
  }

  close() {
    this.socket?.destroy();
  }
}
