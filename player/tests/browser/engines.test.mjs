// A stream in scenes of three.js and PlayCanvas: what decogs-decode draws, and behind what is opaque before it.
import assert from "node:assert/strict";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";
import { filed, listed, pixelsOf, psnr, started } from "./harness.mjs";

/** A folder with other releases of both engines (tests/player/test_engines.py). */
const ENGINES = process.env.DECOGS_ENGINES;
const alias = ENGINES === undefined ? {} : Object.fromEntries(["three", "playcanvas"].map((name) => [name, join(ENGINES, "node_modules", name)]));

/** Engines blend in eight bits, farthest first, which rounds what each Gaussian leaves. */
const LEAST_DB = 40;
const COLOUR = [0.2, 0.6, 0.4];
const WALL = 1.8;

let browser, page;
before(async () => {
  browser = await started();
  const here = dirname(fileURLToPath(import.meta.url));
  await build({ entryPoints: [join(here, "engines_page.mjs")], outfile: join(process.env.DECOGS_PAGE, "engines.js"), alias, loader: { ".wasm": "empty" }, external: ["node:worker_threads"], bundle: true, format: "esm", logLevel: "error" });
  if (ENGINES === undefined) {
    const script = `import { WebGPURenderer } from "three/webgpu"; globalThis.WebGPURenderer = WebGPURenderer;`;
    await build({ stdin: { contents: script, resolveDir: here }, outfile: join(process.env.DECOGS_PAGE, "webgpu.js"), bundle: true, format: "esm", logLevel: "error" });
  }
  page = await browser.opened("none", { width: 640, height: 480 });
  await page.evaluate(() => document.body.replaceChildren());
  await page.addScriptTag({ type: "module", url: "/page/engines.js" });
  await page.waitForFunction(() => globalThis.refused !== undefined);
  if (ENGINES === undefined) {
    await page.addScriptTag({ type: "module", url: "/page/webgpu.js" });
    await page.waitForFunction(() => globalThis.WebGPURenderer !== undefined);
  }
  page.complaints.length = 0;
});
after(() => browser.close());

const expected = (stream, frame = 0) => filed(page, listed().pictures.find((each) => each.stream === stream && each.frame === frame && each.camera === "cam00").file);

async function drawn(engine, stream, options) {
  const told = await page.evaluate(([engine, address, options]) => globalThis.drawn[engine](address, options), [engine, `/data/${stream}.dgs`, { colour: COLOUR, wall: null, ...options }]);
  assert.equal(told.error, 0);
  assert.deepEqual(page.complaints, []);
  return { ...told, picture: await pixelsOf(page, told.picture) };
}

for (const engine of ["three", "playcanvas"]) {
  const cases = [
    ["alone", "engine", {}],
    ["before an opaque wall that stands in it", "engine_nearer", { wall: WALL }],
    ["the same, twice as large and far", "engine_nearer", { wall: 2 * WALL, scale: 2 }],
    ["a stream that is shown elsewhere than it is stored", "shown0", { colour: [0.2, 0.3, 0.5], frame: 3 }],
  ];
  for (const [what, like, options] of cases) {
    test(`${engine}: ${what}`, async (context) => {
      const { picture } = await drawn(engine, like === "shown0" ? like : "engine", options);
      const decibels = psnr(picture, await expected(like, options.frame));
      context.diagnostic(`${decibels.toFixed(1)} dB`);
      assert.ok(decibels >= LEAST_DB, `${decibels.toFixed(2)} dB`);
    });
  }

  test(`${engine}: frames go on while it draws, and what is before the stream stays so`, async () => {
    const told = await drawn(engine, "degree1", { play: true, before: true });
    assert.ok(told.frames >= 5);
    const { width, height, data } = told.picture;
    const middle = 4 * (width * (height >> 1) + (width >> 1));
    assert.ok(data[middle] > 120 && data[middle + 1] > 120, `${[...data.subarray(middle, middle + 3)]}`);
  });
}

test("three: into a target that holds light", async (context) => {
  const { picture } = await drawn("three", "engine", { linear: true });
  const decibels = psnr(picture, await expected("engine"));
  context.diagnostic(`${decibels.toFixed(1)} dB`);
  // Half-covered pixels are brighter where light blends: only where Gaussians are opaque is it the same.
  assert.ok(decibels >= 25, `${decibels.toFixed(2)} dB`);
});

const REFUSED = [
  ["three", "orthographic", /orthographic camera/],
  ["three", "uneven", /alike in all directions/],
  ["three", "mirrored", /not mirrored/],
  ["three", "logarithmic", /logarithmic depth/],
  ["three", "webgpu", /WebGPURenderer/],
  ["playcanvas", "orthographic", /orthographic camera/],
  ["playcanvas", "uneven", /alike in all directions/],
  ["playcanvas", "mirrored", /not mirrored/],
  ["playcanvas", "no WebGL2", /WebGL2 device/],
];
for (const [engine, how, said] of REFUSED) {
  test(`${engine}, ${how}: nothing is drawn, which is said once`, async (context) => {
    if (how === "webgpu" && ENGINES !== undefined) return context.skip("not every release has this renderer");
    const told = await page.evaluate(([engine, address, how]) => globalThis.refused[engine](address, how, globalThis.WebGPURenderer), [engine, "/data/engine.dgs", how]);
    assert.match(String(told.error), said);
    assert.deepEqual([told.errors, told.nothing], [1, true]);
    assert.deepEqual(page.complaints.splice(0).filter((text) => said.test(text)).length, how === "no WebGL2" ? 0 : 1);
  });
}

for (const engine of ["three", "playcanvas"]) {
  test(`${engine}: an object of no size is not drawn, and nothing is wrong`, async () => {
    const told = await page.evaluate(([engine, address]) => globalThis.refused[engine](address, "nothing"), [engine, "/data/engine.dgs"]);
    assert.deepEqual(told, { error: null, errors: 0, nothing: true, behind: 0 });
    assert.deepEqual(page.complaints, []);
  });

  test(`${engine}: the same camera draws what may be drawn, and nothing of a stream that was given back`, async () => {
    const told = await page.evaluate(([engine, address]) => globalThis.refused[engine](address, "whole"), [engine, "/data/engine.dgs"]);
    assert.deepEqual(told, { error: null, errors: 0, nothing: false, behind: 0 });
    assert.deepEqual(page.complaints, []);
  });
}
