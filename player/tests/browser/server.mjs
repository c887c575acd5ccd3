// A plain file server for tests: with or without ranges; what lies in `data` slow, gone or compressed where a test asks for it.
import { createServer } from "node:http";
import { closeSync, createReadStream, openSync, readFileSync, readSync, statSync } from "node:fs";
import { extname, join, normalize } from "node:path";
import { gzipSync } from "node:zlib";

const TYPES = { ".css": "text/css", ".html": "text/html", ".js": "text/javascript", ".json": "application/json", ".wasm": "application/wasm" };

const PIECE = 4096;

/** A link of so many bytes a second, which all answers share: a token bucket of one piece. */
class Link {
  free = 0;
  sent = 0;

  async send(response, path, from, to, options) {
    const file = openSync(path, "r");
    try {
      for (let at = from; at <= to && !response.destroyed; at += PIECE) {
        const piece = Buffer.alloc(Math.min(PIECE, to + 1 - at));
        readSync(file, piece, 0, piece.length, at);
        this.free = Math.max(this.free, performance.now()) + (1000 * piece.length) / options.rate;
        const wait = this.free - performance.now();
        if (wait > 1) await new Promise((done) => setTimeout(done, wait));
        response.write(piece);
        this.sent += piece.length;
      }
    } finally {
      closeSync(file);
    }
    response.end();
  }
}

/**
 * Serves folders, by the first part of the path: { "page": "/a", "data": "/b" }. Options may change any time: `ranges`; `headers` of every answer;
 * of `data`: `rate`, bytes a second; `latency`, milliseconds before an answer; `down`, no answer at all; `gzip`, stored compressed, as buckets do.
 */
export async function served(folders, options = { ranges: true }) {
  const requests = [];
  const link = new Link();
  const server = createServer((request, response) => {
    const { pathname } = new URL(request.url, "http://localhost");
    const [, name, ...rest] = normalize(decodeURIComponent(pathname)).split("/");
    const folder = folders[name];
    const path = folder && join(folder, rest.join("/") || "index.html");
    let size;
    try {
      size = statSync(path).size;
    } catch {
      response.writeHead(404).end();
      return;
    }
    requests.push({ path: pathname, range: request.headers.range ?? null });
    const slow = name === "data" && options.rate !== undefined;
    if (name === "data" && options.down) {
      request.socket.destroy();
      return;
    }
    const send = async (from, to) => {
      if (name === "data" && options.latency > 0) await new Promise((done) => setTimeout(done, options.latency));
      if (slow) void link.send(response, path, from, to, options);
      else createReadStream(path, { start: from, end: to }).pipe(response);
    };
    if (name === "data" && options.gzip) {
      const stored = gzipSync(readFileSync(path));
      const part = /^bytes=(\d+)-(\d+)$/.exec(request.headers.range ?? "");
      const compressed = { "content-encoding": "gzip", "content-type": "application/octet-stream" };
      if (part) {
        const [from, to] = [Number(part[1]), Math.min(Number(part[2]), stored.length - 1)];
        response.writeHead(206, { ...compressed, "content-range": `bytes ${from}-${to}/${stored.length}` }).end(stored.subarray(from, to + 1));
      } else response.writeHead(200, compressed).end(stored);
      return;
    }
    const headers = { "content-type": TYPES[extname(path)] ?? "application/octet-stream", "cache-control": name === "data" ? "no-store" : "max-age=60", ...options.headers };
    const range = options.ranges && /^bytes=(\d+)-(\d*)$/.exec(request.headers.range ?? "");
    if (options.ranges) headers["accept-ranges"] = "bytes";
    if (!range) {
      response.writeHead(200, { ...headers, "content-length": size });
      if (request.method === "HEAD") response.end();
      else void send(0, size - 1);
      return;
    }
    const from = Number(range[1]);
    const to = Math.min(size - 1, range[2] === "" ? size - 1 : Number(range[2]));
    if (from > to) {
      response.writeHead(416, { "content-range": `bytes */${size}` }).end();
      return;
    }
    response.writeHead(206, { ...headers, "content-length": to - from + 1, "content-range": `bytes ${from}-${to}/${size}` });
    void send(from, to);
  });
  await new Promise((listening) => server.listen(0, "127.0.0.1", listening));
  return {
    /** Cuts every connection. */
    cut: () => server.closeAllConnections(),
    address: `http://127.0.0.1:${server.address().port}`,
    requests,
    options,
    /** Bytes of `data` that have gone over a slow link so far. */
    sent: () => link.sent,
    close: () => new Promise((closed) => {
      server.close(closed);
      server.closeAllConnections();
    }),
  };
}
