// A plain file server for tests: with or without ranges, slow or cut where a test asks for it.
import { createServer } from "node:http";
import { createReadStream, statSync } from "node:fs";
import { extname, join, normalize } from "node:path";

const TYPES = { ".html": "text/html", ".js": "text/javascript", ".json": "application/json", ".wasm": "application/wasm" };

/** Serves folders, by the first part of the path: { "page": "/a", "data": "/b" }. `options.ranges` may change any time. */
export async function served(folders, options = { ranges: true }) {
  const requests = [];
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
    const headers = { "content-type": TYPES[extname(path)] ?? "application/octet-stream", "cache-control": "no-store" };
    const range = options.ranges && /^bytes=(\d+)-(\d*)$/.exec(request.headers.range ?? "");
    if (options.ranges) headers["accept-ranges"] = "bytes";
    if (!range) {
      response.writeHead(200, { ...headers, "content-length": size });
      if (request.method === "HEAD") response.end();
      else createReadStream(path).pipe(response);
      return;
    }
    const from = Number(range[1]);
    const to = Math.min(size - 1, range[2] === "" ? size - 1 : Number(range[2]));
    if (from > to) {
      response.writeHead(416, { "content-range": `bytes */${size}` }).end();
      return;
    }
    response.writeHead(206, { ...headers, "content-length": to - from + 1, "content-range": `bytes ${from}-${to}/${size}` });
    createReadStream(path, { start: from, end: to }).pipe(response);
  });
  await new Promise((listening) => server.listen(0, "127.0.0.1", listening));
  return {
    address: `http://127.0.0.1:${server.address().port}`,
    requests,
    options,
    close: () => new Promise((closed) => {
      server.close(closed);
      server.closeAllConnections();
    }),
  };
}
