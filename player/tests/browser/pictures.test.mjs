// What is drawn is what decogs-decode draws: trained scenes, every degree of harmonics, cameras of the rig and a free one.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { filed, listed, picture, pixelsOf, psnr, ready, show, started, until } from "./harness.mjs";

const LEAST_DB = 40;
let browser;
before(async () => (browser = await started()));
after(() => browser.close());

const { pictures } = listed();
// Recorded pictures, and those of a stream that is shown elsewhere than it is stored, come from the decoder's kernel, too.
const cases = pictures.flatMap((each) => (each.recorded || each.stream.startsWith("shown") ? [each, { ...each, exact: true }] : [each]));
for (const { stream, frame, camera, pose, file, recorded, exact } of cases) {
  const kind = `${recorded ? ", as recorded" : ""}${exact ? ", exact" : ""}`;
  test(`${stream}, frame ${frame}, ${camera ?? "a free camera"}${kind}`, async (context) => {
    const more = `${recorded ? "&recorded" : ""}${exact ? "&exact" : ""}`;
    const query = camera === null ? more : `&camera=${encodeURIComponent(camera)}${more}`;
    const page = await browser.opened(stream, { query });
    await ready(page);
    await show(page, frame);
    if (camera === null) await lookFreely(page, pose);
    const expected = await filed(page, file);
    const found = await picture(page, expected.width, expected.height);
    const decibels = Math.min(psnr(found, expected), psnr(found, expected, 255));
    context.diagnostic(`${decibels.toFixed(1)} dB`);
    assert.ok(decibels >= LEAST_DB, `${decibels.toFixed(2)} dB`);
    assert.deepEqual(page.complaints, []);
    await page.context().close();
  });
}

async function lookFreely(page, pose) {
  await page.evaluate(({ width, height, fov_y, position, look_at, up }) => {
    const player = document.querySelector("decogs-player");
    const minus = (a, b) => a.map((value, i) => value - b[i]);
    const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    const unit = (a) => a.map((value) => value / Math.hypot(...a));
    const forward = unit(minus(look_at, position));
    const right = unit(cross(forward, up));
    const focal = height / 2 / Math.tan((fov_y * Math.PI) / 360);
    const lens = { width, height, fx: focal, fy: focal, cx: width / 2, cy: height / 2, near: 0 };
    player.lookFrom({ axes: [right, cross(forward, right), forward], centre: position }, lens);
  }, pose);
}

test("a camera copied as pose.json is the one in the picture", async () => {
  const page = await browser.opened("degree1", { query: "&camera=off%20centre" });
  await ready(page);
  const text = await page.evaluate(async () => {
    const { poseFile } = await import("/page/decogs-player.js");
    return poseFile(document.querySelector("decogs-player").currentCamera(180, 140));
  });
  const found = JSON.parse(text);
  assert.deepEqual([found.width, found.height, found.fx, found.fy, found.cx, found.cy], [180, 140, 130, 142, 70, 80]);
  const expected = [[1, 0, 0, 0.2], [0, 1, 0, -0.1], [0, 0, 1, 0.5], [0, 0, 0, 1]];
  found.world_to_camera.flat().forEach((value, i) => assert.ok(Math.abs(value - expected.flat()[i]) < 1e-12));
  await page.context().close();
});

test("a camera copied as pose.json has the near plane of the view", async () => {
  const page = await browser.opened("degree2");
  await ready(page);
  const text = await page.evaluate(async () => {
    const { poseFile } = await import("/page/decogs-player.js");
    return poseFile(document.querySelector("decogs-player").currentCamera());
  });
  assert.equal(JSON.parse(text).near, 0.6);
  await page.context().close();
});

test("a link shows the same view", async () => {
  const page = await browser.opened("degree2", { query: "&camera=turned" });
  await ready(page);
  await show(page, 2);
  const here = await picture(page, 200, 150);
  const link = await page.evaluate(async () => {
    const { cameraToLink } = await import("/page/decogs-player.js");
    const { pose, lens } = document.querySelector("decogs-player").view;
    return `#camera=${cameraToLink(pose, lens)}&frame=2`;
  });
  const other = await browser.opened("degree2", { query: link });
  await ready(other);
  await other.waitForFunction(() => document.querySelector("decogs-player").info.frame === 2);
  assert.ok(psnr(await picture(other, 200, 150), here) > 50);
  for (const each of [page, other]) await each.context().close();
});

test("a picture on a screen of two device pixels has twice the size", async () => {
  const page = await browser.opened("arc", { scale: 2 });
  await ready(page);
  const { width, height } = await picture(page);
  assert.deepEqual([width, height], [400, 300]);
  await page.context().close();
});

test("where WebGL is software, the kernel draws by itself; overlays, and who wants it, get WebGL", async () => {
  const page = await browser.opened("degree1", { automatic: true });
  await ready(page);
  const exact = () => page.evaluate(() => document.querySelector("decogs-player").exact);
  assert.equal(await exact(), true);
  await page.evaluate(() => (document.querySelector("decogs-player").overlay = "motion"));
  assert.equal(await exact(), false);
  await page.evaluate(() => (document.querySelector("decogs-player").overlay = "none"));
  assert.equal(await exact(), true);
  await page.evaluate(() => (document.querySelector("decogs-player").exact = false));
  assert.equal(await exact(), false);
  await until(page, "!inside.stage.pending && !inside.stage.renderer.busy");
  assert.deepEqual(page.complaints, []);
  await page.context().close();
});

test("a picture that is saved right after another renderer was chosen is whole", async () => {
  const page = await browser.opened("degree1", { automatic: true });
  await ready(page);
  await show(page, 3);
  const { file } = pictures.find(({ stream, frame, camera }) => stream === "degree1" && frame === 3 && camera === "cam00");
  const expected = await filed(page, file);
  for (const exact of [false, true, false]) {
    await page.evaluate((exact) => {
      document.querySelector("decogs-player").exact = exact;
    }, exact);
    const decibels = psnr(await picture(page, expected.width, expected.height), expected);
    assert.ok(decibels >= LEAST_DB, `${decibels.toFixed(2)} dB, exact ${exact}`);
  }
  await page.context().close();
});

/** What a slow graphics card draws while the camera moves. */
const quickly = (page, quick, width, height) =>
  page.evaluate(([quick, width, height]) => {
    const { stage } = document.querySelector("decogs-player")[Symbol.for("decogs.inside")];
    stage.renderer.draw(stage.camera(width, height), "none", quick);
    return stage.renderer.canvas.toDataURL();
  }, [quick, width, height]).then((address) => pixelsOf(page, address));

test("what is drawn quickly is almost the same; that of a subject, and of what was recorded, is", async (context) => {
  for (const [stream, query] of [["degree1", ""], ["wide", ""], ["subject", ""], ["recorded", "&recorded"]]) {
    const page = await browser.opened(stream, { query });
    await ready(page);
    await until(page, "!inside.stage.pending && !inside.stage.renderer.busy");
    const [quick, whole] = [await quickly(page, true, 200, 150), await quickly(page, false, 200, 150)];
    const decibels = psnr(quick, whole);
    context.diagnostic(`${stream}: ${decibels.toFixed(1)} dB`);
    if (query !== "" || stream === "subject") assert.deepEqual(quick.data, whole.data);
    else assert.ok(decibels >= LEAST_DB && decibels < 80, `${stream}: ${decibels.toFixed(1)} dB`);
    await page.context().close();
  }
});
