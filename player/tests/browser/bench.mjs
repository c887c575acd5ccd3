// Times the player in headless Chromium: node tests/browser/bench.mjs PAGE ROUNDS STREAM.dgs ..., medians as JSON lines.
// Several pages, PAGE,PAGE,...: what drawing costs in each, in turn, and whether the pictures are the same.
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

/** Milliseconds that pictures of some sizes take, with the last one's pixels: the GPU's queue is empty before and after. */
async function drawn([stream, sizes]) {
  const player = document.createElement("decogs-player");
  if ("figures" in player) player.setAttribute("exact", "off"); // builds before that draw by WebGL2 anyway
  player.style.cssText = "position: fixed; inset: 0; width: 160px; height: 120px";
  player.src = stream;
  const loaded = new Promise((done) => player.addEventListener("loadeddata", done, { once: true }));
  document.body.replaceChildren(player);
  await loaded;
  const { stage } = player[Symbol.for("decogs.inside")] ?? player;
  await player.capture(64, 48);
  const { renderer } = stage;
  const gl = renderer.canvas.getContext("webgl2");
  const finish = () => gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  const told = [];
  for (const [width, height] of sizes) {
    const begun = performance.now();
    renderer.draw(stage.camera(width, height), "none", false);
    finish();
    told.push(performance.now() - begun);
  }
  const bytes = await (await player.capture(320, 240)).arrayBuffer();
  const hash = new Uint8Array(await crypto.subtle.digest("SHA-256", bytes));
  player.remove();
  return { ms: told, picture: Array.from(hash, (byte) => byte.toString(16).padStart(2, "0")).join("") };
}

/** Pictures a second while the camera circles, drawn by what the player chooses and by WebGL2, at 480x272. */
async function circling([stream, exact]) {
  const player = document.createElement("decogs-player");
  if (exact !== null && "figures" in player) player.setAttribute("exact", exact);
  player.style.cssText = "position: fixed; inset: 0; width: 480px; height: 272px";
  player.src = stream;
  const loaded = new Promise((done) => player.addEventListener("loadeddata", done, { once: true }));
  document.body.replaceChildren(player);
  await loaded;
  const { stage } = player[Symbol.for("decogs.inside")] ?? player;
  await player.capture(64, 48);
  const seen = new Set();
  const begun = performance.now();
  while (performance.now() - begun < 4000) {
    stage.navigation.orbit(0.02, 0);
    player.lookFrom(stage.navigation.pose, stage.navigation.lens);
    await new Promise(requestAnimationFrame);
    for (const at of stage.drawnAt) if (at > begun) seen.add(at);
  }
  const { width } = stage.renderer.canvas;
  player.remove();
  return { pictures: seen.size / 4, width };
}

const SIZES = [[48, 27], [192, 109], [480, 272], [960, 544]];

/** One row a page. */
async function compared(browser, pages, stream) {
  const runs = pages.map(() => []);
  for (let round = 0; round < Number(rounds); round++) {
    for (const [at, folder] of pages.entries()) {
      const server = await served({ page: resolve(folder), data: dirname(resolve(stream)) });
      const context = await browser.newContext({ viewport: { width: 640, height: 480 } });
      const tab = await context.newPage();
      await tab.goto(`${server.address}/page/index.html`);
      await tab.waitForFunction(() => customElements.get("decogs-player") !== undefined);
      await tab.evaluate(() => document.body.replaceChildren());
      const address = `${server.address}/data/${basename(stream)}`;
      const [webgl, chosen] = [await tab.evaluate(circling, [address, "off"]), await tab.evaluate(circling, [address, null])];
      runs[at].push({ ...(await tab.evaluate(drawn, [address, SIZES])), webgl, chosen });
      await context.close();
      await server.close();
    }
  }
  for (const [at, folder] of pages.entries()) {
    const row = { stream: basename(stream), page: folder, same: runs[at].every(({ picture }) => picture === runs[0][0].picture) };
    for (const [size, [width, height]] of SIZES.entries()) row[`${width}x${height}`] = Math.round(median(runs[at].map(({ ms }) => ms[size])));
    for (const name of ["webgl", "chosen"]) {
      row[name] = median(runs[at].map((run) => run[name].pictures));
      row[`${name}Width`] = median(runs[at].map((run) => run[name].width));
    }
    console.log(JSON.stringify(row));
  }
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
  const pages = page.split(",");
  for (const stream of pages.length > 1 ? streams : []) await compared(browser, pages, stream);
  for (const stream of pages.length > 1 ? [] : streams) {
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
