// Headsets: one that iwer simulates.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { after, before, test } from "node:test";
import { pixelsOf, psnr, ready, show, started, until } from "./harness.mjs";

const IWER = createRequire(import.meta.url).resolve("iwer").replace(/\/lib\/.*$/, "/build/iwer.min.js");
let browser;
before(async () => (browser = await started()));
after(() => browser.close());

/** A page with a headset, and a view that is level and asymmetric enough to tell eyes apart. */
async function withHeadset(stereo, stream = "degree1") {
  const page = await browser.opened("none", { width: 640, height: 480 });
  const begin = (stereo) => {
    const { XRDevice, metaQuest3 } = globalThis.IWER;
    globalThis.device = new XRDevice(metaQuest3, { stereoEnabled: stereo });
    globalThis.device.installRuntime({ forceInstall: true });
    const ask = navigator.xr.requestSession.bind(navigator.xr);
    globalThis.pictures = 0;
    navigator.xr.requestSession = async (...given) => {
      const session = (globalThis.session = await ask(...given));
      const draw = session.requestAnimationFrame.bind(session);
      session.requestAnimationFrame = (drawn) => {
        globalThis.pictures += 1;
        return draw(drawn);
      };
      return session;
    };
  };
  await page.addInitScript({ content: `${readFileSync(IWER, "utf8")}\n(${begin})(${stereo});` });
  await page.goto(`${browser.server.address}/page/index.html?src=/data/${stream}.dgs&exact=off`);
  page.complaints.length = 0;
  await ready(page);
  return page;
}

/** Waits for so many more pictures of the headset. */
const pictures = async (page, count) => {
  const before = await page.evaluate(() => globalThis.pictures);
  await page.waitForFunction((until) => globalThis.pictures >= until, before + count);
};

/** The picture of each eye, and the cameras of both, in the frame after the next. */
const eyes = (page) =>
  page.evaluate(async () => {
    const player = document.querySelector("decogs-player");
    const { session } = globalThis;
    const space = await session.requestReferenceSpace("local");
    const frames = (count) => new Promise((done) => {
      const tick = (_, frame) => (--count > 0 ? session.requestAnimationFrame(tick) : done(read(frame)));
      const read = (frame) => {
        const layer = session.renderState.baseLayer;
        const { gl } = { gl: player[Symbol.for("decogs.inside")].stage.renderer.canvas.getContext("webgl2") };
        return frame.getViewerPose(space).views.filter((view) => layer.getViewport(view).width > 0).map((view) => {
          const { x, y, width, height } = layer.getViewport(view);
          const bytes = new Uint8Array(4 * width * height);
          gl.readPixels(x, y, width, height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
          const canvas = new OffscreenCanvas(width, height);
          const image = new ImageData(width, height);
          for (let row = 0; row < height; row++) image.data.set(bytes.subarray(4 * width * (height - 1 - row), 4 * width * (height - row)), 4 * width * row);
          canvas.getContext("2d").putImageData(image, 0, 0);
          return canvas.convertToBlob().then(async (blob) => ({
            width,
            height,
            projection: [...view.projectionMatrix],
            position: [view.transform.position.x, view.transform.position.y, view.transform.position.z],
            png: await new Promise((done) => {
              const reader = new FileReader();
              reader.onload = () => done(reader.result);
              reader.readAsDataURL(blob);
            }),
          }));
        });
      };
      session.requestAnimationFrame(tick);
    });
    return Promise.all(await frames(4));
  });

/** So many metres to the right, up and back of where somebody began. */
function aside({ pose: { axes, centre }, size }, metres) {
  const units = metres.map((value, i) => ((size / 2.5) * value) * (i === 0 ? 1 : -1));
  return centre.map((value, i) => value + units.reduce((sum, unit, k) => sum + unit * axes[k][i], 0));
}

for (const [stereo, stream] of [[false, "degree1"], [true, "degree1"], [false, "shown0"]]) {
  test(`${stereo ? "two eyes see" : "one eye sees"} of ${stream} what a camera in their place sees`, async () => {
    const page = await withHeadset(stereo, stream);
    const start = await page.evaluate(async () => {
      const player = document.querySelector("decogs-player");
      // A camera that stands level in the scene as it is stored, in the world that it is shown in.
      const { rotation: r, scale, shift } = player.header.presentation.transform ?? { rotation: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], scale: 1, shift: [0, 0, 0] };
      const axes = [0, 1, 2].map((column) => r.map((row) => row[column]));
      const centre = r.map((row, i) => scale * (0.1 * row[0] - 0.1 * row[1] - 0.2 * row[2]) + shift[i]);
      player.lookFrom({ axes, centre }, player.view.lens);
      const { size } = player[Symbol.for("decogs.inside")].stage.navigation;
      await player.enterXr("immersive-vr");
      return { size, ...player.view };
    });
    await page.waitForTimeout(500);
    const seen = await eyes(page);
    assert.equal(seen.length, stereo ? 2 : 1);
    await page.evaluate(() => document.querySelector("decogs-player").leaveXr());
    const head = seen.reduce((sum, { position }) => sum.map((value, i) => value + position[i] / seen.length), [0, 0, 0]);
    for (const { width, height, projection: p, position, png } of seen) {
      const expected = await page.evaluate(async ({ p, width, height, centre, axes }) => {
        const player = document.querySelector("decogs-player");
        const lens = { width, height, fx: (p[0] * width) / 2, fy: (p[5] * height) / 2, cx: ((1 - p[8]) * width) / 2, cy: ((1 + p[9]) * height) / 2, near: 0 };
        player.lookFrom({ axes, centre }, lens);
        const blob = await player.capture(width, height);
        return new Promise((done) => {
          const reader = new FileReader();
          reader.onload = () => done(reader.result);
          reader.readAsDataURL(blob);
        });
      }, { p, width, height, centre: aside(start, position.map((value, i) => value - head[i])), axes: start.pose.axes });
      const decibels = psnr(await pixelsOf(page, png), await pixelsOf(page, expected));
      // The near planes differ by Gaussians that almost touch the eyes.
      assert.ok(decibels > 40, `${decibels.toFixed(1)} dB`);
    }
    assert.deepEqual(page.complaints, []);
    await page.context().close();
  });
}

test("the menu offers the headset; the trigger plays, frames go on, and the page is as it was afterwards", async () => {
  const page = await withHeadset(true);
  await page.evaluate(() => (document.querySelector("decogs-player").loop = true));
  await page.locator("[name=menu]").click();
  await page.locator("[name=vr]").click();
  // Held over two of the headset's pictures: they take long in software, and a press between two is seen by none.
  await pictures(page, 2);
  await page.evaluate(() => globalThis.device.controllers.right.updateButtonValue("trigger", 1));
  await pictures(page, 3);
  await page.evaluate(() => globalThis.device.controllers.right.updateButtonValue("trigger", 0));
  await until(page, "!player.paused && player.info.frame > 0");
  await page.evaluate(() => globalThis.session.end());
  // While it plays in software there is always a picture to draw.
  await page.evaluate(() => document.querySelector("decogs-player").pause());
  await until(page, "!player.exact && !inside.stage.pending");
  await show(page, 2);
  assert.deepEqual(page.complaints, []);
  await page.context().close();
});

test("without a headset, entering is refused in a sentence", async () => {
  const page = await browser.opened("degree1");
  await ready(page);
  const told = await page.evaluate(() => document.querySelector("decogs-player").enterXr("immersive-vr").then(() => "entered", String));
  assert.notEqual(told, "entered");
  await page.context().close();
});
