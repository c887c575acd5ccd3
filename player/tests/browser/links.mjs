// Plays a stream over links that are slow, go away or have their own ways:
//   node tests/browser/links.mjs PAGE STREAM.dgs PICTURE.svg     a table, and in the picture a curve for each link
// Nothing is drawn in the browser: software takes all processors for it, and frames would be late whose bytes are there.
import { statSync, writeFileSync } from "node:fs";
import { basename, dirname, resolve } from "node:path";
import { chromiumPath, launched } from "./chromium.mjs";
import { curves } from "./curves.mjs";
import { served } from "./server.mjs";

const [page, stream, picture] = process.argv.slice(2);
if (chromiumPath === undefined) {
  console.error("Chromium is not installed (DECOGS_CHROMIUM names another place)");
  process.exit(77);
}
const SIZE = statSync(stream).size;
const SAMPLE_MS = 200;
const MOST_SECONDS = 90;
/** Bytes a second: of a link, or `times` those of the stream. `gone`: from so many seconds on, for so many, nothing answers. */
const LINKS = [
  { name: "0.5 times the stream's rate", times: 0.5 },
  { name: "1.0 times", times: 1 },
  { name: "1.2 times", times: 1.2 },
  { name: "2 times", times: 2 },
  { name: "2 Mbit/s", rate: 2e6 / 8 },
  { name: "1.2 times, gone for 10 s", times: 1.2, gone: [8, 10] },
  { name: "1.2 times, 200 ms latency", times: 1.2, latency: 200 },
  { name: "1.2 times, no ranges", times: 1.2, ranges: false },
];

/** In a page whose player has no stream yet: plays one, notes when frames are shown and waited for, and has `sample` tell how it stands. */
function begin(address) {
  const player = document.querySelector("decogs-player");
  const begun = performance.now();
  const now = () => (performance.now() - begun) / 1000;
  const shown = [];
  const layers = [];
  const waits = [];
  player.addEventListener("loadedmetadata", () => {
    player[Symbol.for("decogs.inside")].stage.renderer.draw = () => undefined;
  });
  player.addEventListener("timeupdate", () => {
    shown.push(now());
    layers[player.info?.frame ?? 0] = player.info?.layer ?? 0;
  });
  player.addEventListener("waiting", () => waits.push({ from: now(), to: Infinity }));
  player.addEventListener("playing", () => waits.length > 0 && (waits.at(-1).to = Math.min(waits.at(-1).to, now())));
  globalThis.sample = () => {
    const { fps, info, bufferedFrames, error, ended } = player;
    const next = (info?.frame ?? -1) + 1;
    const come = bufferedFrames.find(([from, to]) => from <= next && to > next)?.[1] ?? next;
    return { at: now(), shown: next / fps, come: come / fps, over: ended || error !== null };
  };
  globalThis.told = () => ({ shown, waits, layers });
  player.setAttribute("autoplay", "");
  player.src = address;
}

/** Opens a page whose player has another stream, or none. */
async function opened(browser, server, name) {
  const context = await browser.newContext({ viewport: { width: 320, height: 240 } });
  const tab = await context.newPage();
  await tab.goto(`${server.address}/page/index.html?exact=off&src=/data/${name}`);
  return tab;
}

async function secondsOf(browser, server) {
  const tab = await opened(browser, server, basename(stream));
  await tab.waitForFunction(() => document.querySelector("decogs-player")?.[Symbol.for("decogs.inside")].playback.complete);
  const seconds = await tab.evaluate(() => document.querySelector("decogs-player").duration);
  await tab.context().close();
  return seconds;
}

async function played(browser, server, { gone = [Infinity, 0], ...link }) {
  Object.assign(server.options, { ranges: true, latency: 0, down: false, ...link });
  const tab = await opened(browser, server, "none.dgs");
  await tab.waitForFunction(() => document.querySelector("decogs-player")?.error != null);
  const before = server.sent();
  await tab.evaluate(begin, `${server.address}/data/${basename(stream)}`);
  const samples = [];
  do {
    await tab.waitForTimeout(SAMPLE_MS);
    samples.push({ ...(await tab.evaluate(() => globalThis.sample())), bytes: server.sent() - before });
    const { at } = samples.at(-1);
    const down = at >= gone[0] && at < gone[0] + gone[1];
    if (down && !server.options.down) server.cut();
    server.options.down = down;
  } while (!samples.at(-1).over && samples.at(-1).at < MOST_SECONDS);
  const told = await tab.evaluate(() => globalThis.told());
  await tab.context().close();
  const waits = told.waits.map(({ from, to }) => ({ from, to: Math.min(to ?? Infinity, samples.at(-1).at) }));
  return { samples, first: told.shown[0], waits, layers: told.layers.filter((layer) => layer !== null), still: told.shown.slice(1).reduce((most, at, i) => Math.max(most, at - told.shown[i]), 0) };
}

const server = await served({ page: resolve(page), data: dirname(resolve(stream)) });
const browser = await launched();
try {
  const seconds = await secondsOf(browser, server);
  const runs = [];
  console.log(`${basename(stream)}: ${seconds} s, ${((8e-6 * SIZE) / seconds).toFixed(2)} Mbit/s\n`);
  console.log("| link | first picture after | stalls after the start | longest | longest time without a new frame | frames in all layers |\n|---|---|---|---|---|---|");
  for (const { name, times, rate = (times * SIZE) / seconds, ...link } of LINKS) {
    const run = await played(browser, server, { rate, ...link });
    const longest = Math.max(0, ...run.waits.map(({ from, to }) => to - from));
    console.log(`| ${name} | ${run.first.toFixed(2)} s | ${run.waits.length} | ${longest.toFixed(1)} s | ${run.still.toFixed(2)} s | ${run.layers.filter((layer) => layer > 0).length} of ${run.layers.length} |`);
    runs.push({ name, ...run });
  }
  writeFileSync(picture, curves(runs, seconds, SIZE));
} finally {
  await browser.close();
  await server.close();
}
