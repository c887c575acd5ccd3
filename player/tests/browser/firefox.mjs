// Drives the Firefox that is installed by WebDriver BiDi, its own protocol: as much of it as the tests need.
import { spawn } from "node:child_process";
import { existsSync, mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";

const PLACES = [process.env.DECOGS_FIREFOX, "/usr/bin/firefox-esr", "/usr/bin/firefox"];

/** The browser's path; undefined where there is none. */
export const firefoxPath = PLACES.find((path) => path && existsSync(path));

export async function firefox() {
  const profile = mkdtempSync(join(tmpdir(), "decogs-firefox-"));
  const program = spawn(firefoxPath, ["--headless", "--remote-debugging-port", "0", "--profile", profile, "--no-remote"], { stdio: ["ignore", "ignore", "pipe"] });
  const address = await new Promise((found, failed) => {
    program.stderr.on("data", (text) => {
      const told = /BiDi listening on (ws:\S+)/.exec(String(text));
      if (told) found(told[1]);
    });
    program.on("exit", () => failed(new Error("Firefox ended before it could be driven")));
  });
  const socket = new WebSocket(`${address}/session`);
  await new Promise((open, failed) => Object.assign(socket, { onopen: open, onerror: failed }));
  const waiting = new Map();
  let count = 0;
  socket.onmessage = ({ data }) => {
    const { id, result, message } = JSON.parse(data);
    waiting.get(id)?.(result === undefined ? Promise.reject(new Error(message)) : result);
  };
  const call = (method, params = {}) => {
    const id = ++count;
    socket.send(JSON.stringify({ id, method, params }));
    return new Promise((done) => waiting.set(id, done));
  };
  await call("session.new", { capabilities: {} });
  const { contexts } = await call("browsingContext.getTree");
  const { context } = contexts[0];
  return {
    go: (url) => call("browsingContext.navigate", { context, url, wait: "complete" }),
    /** What a function of the page, async or not, returns, as JSON can hold it. */
    async evaluate(work, ...given) {
      const expression = `(async () => JSON.stringify(await (${work})(...${JSON.stringify(given)})))()`;
      const { result, exceptionDetails } = await call("script.evaluate", { expression, target: { context }, awaitPromise: true });
      if (exceptionDetails) throw new Error(exceptionDetails.text);
      return JSON.parse(result.value);
    },
    async close() {
      socket.close();
      const ended = new Promise((done) => program.on("exit", done));
      program.kill();
      await ended;
      rmSync(profile, { recursive: true, force: true });
    },
  };
}
