// Times the first picture in headless Chromium: node tests/browser/first.mjs ROUNDS STREAM.dgs PAGE [PAGE ...], the pages in
// turn. Milliseconds from the start of navigation, medians: the element is known, the worker's first word, the header, the
// first frame, its textures and order handed to WebGL, and the picture on the canvas. What begins with `src` is
// counted from setting it in a page whose scripts are there.
import { basename, dirname, resolve } from "node:path";
import { loadavg } from "node:os";
import { chromiumPath, launched } from "./chromium.mjs";
import { served } from "./server.mjs";

const [rounds, stream, ...pages] = process.argv.slice(2);
if (chromiumPath === undefined) {
  console.error("Chromium is not installed (DECOGS_CHROMIUM names another place)");
  process.exit(77);
}
const SIZE = { width: 160, height: 120 };

/** Runs before any script of the page: notes when what happens for the first time. */
function watchful() {
  const told = (globalThis.told = {});
  const note = (name) => (told[name] ??= performance.now());
  const { Worker: Given } = globalThis;
  globalThis.Worker = class extends Given {
    constructor(...given) {
      note("workerAsked");
      super(...given);
      this.addEventListener("message", ({ data }) => {
        note(data.type);
        if (data.type === "frame") told.parts ??= [data.info.decodeMs, data.info.packMs, data.draw.sortMs];
      });
    }
    postMessage(...given) {
      note(`sent ${given[0].type}`);
      super.postMessage(...given);
    }
  };
  customElements.whenDefined("decogs-player").then(() => note("defined"));
  const draw = WebGL2RenderingContext.prototype.drawArraysInstanced;
  const link = WebGL2RenderingContext.prototype.linkProgram;
  WebGL2RenderingContext.prototype.linkProgram = function (...given) {
    note("shaders");
    return link.apply(this, given);
  };
  WebGL2RenderingContext.prototype.drawArraysInstanced = function (...given) {
    const result = draw.apply(this, given);
    if (given[3] === 0 || told.drawCall !== undefined) return result;
    note("drawCall");
    const fence = this.fenceSync(this.SYNC_GPU_COMMANDS_COMPLETE, 0);
    this.flush();
    const poll = () => {
      if (this.clientWaitSync(fence, 0, 0) === this.TIMEOUT_EXPIRED) setTimeout(poll, 1);
      else note("drawn");
    };
    setTimeout(poll);
    return result;
  };
}

async function navigation(browser, address, name) {
  const context = await browser.newContext({ viewport: SIZE });
  const tab = await context.newPage();
  await tab.addInitScript(watchful);
  await tab.goto(`${address}/page/index.html?src=/data/${name}`);
  await tab.waitForFunction(() => globalThis.told.drawn !== undefined);
  const told = await tab.evaluate(() => globalThis.told);
  await context.close();
  return told;
}

/** The same from setting `src`, in a page of one's own that has had its scripts for a while. */
async function opening(browser, address, name) {
  const context = await browser.newContext({ viewport: SIZE });
  const tab = await context.newPage();
  await tab.addInitScript(watchful);
  await tab.route("**/empty.html", (route) => route.fulfill({ contentType: "text/html", body: "<!doctype html><body>" }));
  await tab.goto(`${address}/empty.html`);
  const took = await tab.evaluate(
    async ([script, stream]) => {
      await import(script);
      await new Promise((done) => setTimeout(done, 500));
      const player = document.createElement("decogs-player");
      player.style.cssText = "position: fixed; inset: 0; width: 160px; height: 120px";
      const begun = performance.now();
      player.src = stream;
      document.body.replaceChildren(player);
      while (globalThis.told.drawCall === undefined) await new Promise((done) => setTimeout(done, 1));
      const { opened, shaders, frame, drawCall } = globalThis.told;
      return [opened, shaders, frame, drawCall].map((at) => at - begun);
    },
    [`${address}/page/decogs-player.js`, `${address}/data/${name}`],
  );
  await context.close();
  return took;
}

const median = (values) => [...values].sort((a, b) => a - b)[values.length >> 1];
const browser = await launched();
try {
  const servers = [];
  for (const page of pages) servers.push(await served({ page: resolve(page), data: dirname(resolve(stream)) }));
  const runs = pages.map(() => []);
  for (let round = 0; round <= Number(rounds); round++) {
    for (const [at, { address }] of servers.entries()) {
      const told = await navigation(browser, address, basename(stream));
      const parts = await opening(browser, address, basename(stream));
      for (const [at, name] of ["opened", "shaders", "frame", "draw call"].entries()) told[`src to ${name}`] = parts[at];
      if (round > 0) runs[at].push(told); // the first of all wakes the browser up
    }
  }
  for (const [at, page] of pages.entries()) {
    for (const run of runs[at]) [run["in decode"], run["in pack"], run["in sort"]] = run.parts;
    const names = Object.keys(runs[at][0]).filter((name) => !["progress", "parts", "sent recycle"].includes(name));
    const row = Object.fromEntries(names.map((name) => [name, Math.round(median(runs[at].map((run) => run[name])))]));
    console.log(JSON.stringify({ page, stream: basename(stream), ...row }));
  }
  console.log(`load ${loadavg()[0].toFixed(1)}`);
  for (const server of servers) await server.close();
} finally {
  await browser.close();
}
