/** A server of one file, of the kinds that there are. */

import { createServer, type IncomingMessage, type ServerResponse } from "node:http";
import type { AddressInfo } from "node:net";

export interface Served {
  readonly address: string;
  /** Each request: its range, or its method. */
  readonly requests: string[];
  stop(): Promise<void>;
}

export interface Manner {
  readonly ranges?: boolean;
  /** Whether the length of a whole file is told. */
  readonly tellsLength?: boolean;
  /** Called before each answer; the answer fails with what it returns. */
  readonly fails?: (request: IncomingMessage) => number | "cut" | null;
  readonly version?: () => string;
}

/** `file` is asked for at each request: it may grow. */
export async function serve(file: () => Uint8Array, manner: Manner = {}): Promise<Served> {
  const requests: string[] = [];
  const server = createServer((request, response) => {
    requests.push(request.headers.range ?? request.method!);
    answer(request, response, file(), manner);
  });
  await new Promise<void>((resolve) => server.listen(0, "127.0.0.1", resolve));
  const { port } = server.address() as AddressInfo;
  return {
    address: `http://127.0.0.1:${port}/scene.dgs`,
    requests,
    stop: () =>
      new Promise((resolve) => {
        server.closeAllConnections();
        server.close(() => {
          resolve();
        });
      }),
  };
}

function answer(request: IncomingMessage, response: ServerResponse, file: Uint8Array, manner: Manner): void {
  const { ranges = true, tellsLength = true, fails, version } = manner;
  const failure = fails?.(request) ?? null;
  if (version) response.setHeader("ETag", version());
  if (typeof failure === "number") {
    response.writeHead(failure).end();
    return;
  }
  const asked = ranges ? /^bytes=(\d+)-(\d+)$/.exec(request.headers.range ?? "") : null;
  const start = asked ? Number(asked[1]) : 0;
  const end = asked ? Math.min(Number(asked[2]) + 1, file.length) : file.length;
  if (asked && start >= file.length) {
    response.writeHead(416, { "Content-Range": `bytes */${file.length}` }).end();
    return;
  }
  if (asked) response.setHeader("Content-Range", `bytes ${start}-${end - 1}/${file.length}`);
  if (tellsLength) response.setHeader("Content-Length", end - start);
  response.writeHead(asked ? 206 : 200);
  if (request.method === "HEAD") response.end();
  else if (failure === "cut") response.write(file.subarray(start, start + (end - start) / 2), () => response.destroy());
  else response.end(file.subarray(start, end));
}
