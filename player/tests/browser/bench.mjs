// Times the player in headless Chromium: node tests/browser/bench.mjs PAGE ROUNDS STREAM.dgs ..., medians as JSON lines.
import { basename, dirname, resolve } from "node:path";
import { chromiumPath, launched } from "./chromium.mjs";
import { served } from "./server.mjs";

const [page, rounds, ...streams] = process.argv.slice(2);
if (chromiumPath === undefined) {
  console.error("Chromium is not installed (DECOGS_CHROMIUM names another place)");
  process.exit(77);
}
const median = (values) => (values.length === 0 ? null : [...values].sort((a, b) => a - b)[values.length >> 1]);

/** In a page of its own, whose scripts are there but for the worker's: a player from nothing to frames and seeks. */
async function watch(stream) {
  const player = document.createElement("decogs-player");
  player.style.cssText = "position: fixed; inset: 0; width: 160px; height: 120px";
  const next = (name) => new Promise((done) => player.addEventListener(name, done, { once: true }));
  const begun = performance.now();
  player.src = stream;
  const loaded = next("loadeddata");
  document.body.replaceChildren(player);
  const inside = () => player[Symbol.for("decogs.inside")] ?? player; // builds before it had one are timed, too
  // In software a picture of 300 000 takes seconds, and all processors: only what leads to it is timed.
  inside().stage.renderer.draw = () => undefined;
  await loaded;
  const first = performance.now() - begun;
  let upload = 0;
  const { stage } = inside();
  const load = stage.load.bind(stage);
  stage.load = (...given) => {
    const start = performance.now();
    load(...given);
    upload = performance.now() - start;
  };
  const seek = async (frame) => {
    const start = performance.now();
    const seeked = next("seeked");
    player.currentFrame = frame;
    await seeked;
    return performance.now() - start;
  };
  while (!inside().playback.complete) await new Promise((done) => setTimeout(done, 20));
  const frames = inside().playback.frameCount;
  const steps = [];
  const keys = [0];
  for (let frame = 1; frame < frames; frame++) {
    await seek(frame);
    const { kind, decodeMs, packMs, changed, count } = player.info;
    if (kind === "key") keys.push(frame);
    if (kind === "delta") steps.push({ decode: decodeMs, pack: packMs, sort: (player.figures ?? player.drawn).sortMs, upload, share: changed / count });
  }
  const seeks = [];
  for (const key of keys.slice(1).reverse()) {
    seeks.push(await seek(key));
    await seek(Math.max(0, key - 2));
  }
  if (keys.length === 1) {
    await seek(frames - 1);
    seeks.push(await seek(0));
  }
  return { gaussians: player.info.count, first, steps, seeks };
}

async function measured(browser, server, stream) {
  const context = await browser.newContext({ viewport: { width: 640, height: 480 } });
  const tab = await context.newPage();
  await tab.goto(`${server.address}/page/index.html`);
  await tab.waitForFunction(() => customElements.get("decogs-player") !== undefined);
  await tab.waitForTimeout(300);
  const told = await tab.evaluate(watch, `${server.address}/data/${basename(stream)}`);
  await context.close();
  return told;
}

const browser = await launched();
try {
  for (const stream of streams) {
    const server = await served({ page: resolve(page), data: dirname(resolve(stream)) });
    const runs = [];
    for (let round = 0; round < Number(rounds); round++) runs.push(await measured(browser, server, stream));
    await server.close();
    const steps = runs.flatMap((run) => run.steps);
    const of = (name) => median(steps.map((step) => step[name]));
    const row = { stream: basename(stream), gaussians: runs[0].gaussians, changing: of("share") };
    for (const name of ["decode", "pack", "sort", "upload"]) row[name] = of(name);
    row.frame = median(steps.map(({ decode, pack, sort, upload }) => decode + pack + sort + upload));
    row.first = median(runs.map((run) => run.first));
    row.seek = median(runs.flatMap((run) => run.seeks));
    console.log(JSON.stringify(row));
  }
} finally {
  await browser.close();
}
