// Hands on: mouse, keys, the bar and its menu, cameras of the rig, overlays, small screens.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { picture, pixelsOf, psnr, ready, show, started, until } from "./harness.mjs";

let browser;
before(async () => (browser = await started()));
after(() => browser.close());

const state = (page) =>
  page.evaluate(() => {
    const player = document.querySelector("decogs-player");
    const { pose, pivot, up } = player[Symbol.for("decogs.inside")].stage.navigation;
    return { axes: pose.axes, centre: pose.centre, pivot, up, camera: player.camera, frame: player.currentFrame };
  });
const distance = (a, b) => Math.hypot(...a.map((value, i) => value - b[i]));
const rested = (page) => until(page, "!inside.stage.pending && !inside.stage.renderer.busy");

async function dragged(page, right, down, button = "left") {
  await page.mouse.move(300, 120);
  await page.mouse.down({ button });
  await page.mouse.move(300 + right, 120 + down, { steps: 4 });
  await page.mouse.up({ button });
  await page.waitForTimeout(700);
}

test("dragging circles the pivot, upright, the near side going with the hand", async () => {
  const page = await browser.opened("dome", { width: 640, height: 400 });
  await ready(page);
  const before = await state(page);
  await dragged(page, 100, 0);
  const beside = await state(page);
  assert.ok(Math.abs(distance(beside.centre, beside.pivot) - distance(before.centre, before.pivot)) < 1e-6);
  const right = before.axes[0].reduce((sum, part, i) => sum + part * (beside.centre[i] - before.centre[i]), 0);
  assert.ok(right < 0, "the camera goes left when the hand goes right");
  assert.equal(beside.camera, "");
  await dragged(page, 0, 60);
  const above = await state(page);
  const height = (of) => of.up.reduce((sum, part, i) => sum + part * of.centre[i], 0);
  assert.ok(height(above) > height(beside), "the camera rises when the hand goes down");
  const roll = above.axes[0].reduce((sum, part, i) => sum + part * above.up[i], 0);
  assert.ok(Math.abs(roll) < 0.02, `the horizon is level: ${roll}`);
  await page.mouse.wheel(0, -300);
  await page.waitForTimeout(700);
  const nearer = await state(page);
  assert.ok(distance(nearer.centre, nearer.pivot) < 0.95 * distance(above.centre, above.pivot));
  await dragged(page, 80, 0, "right");
  const shifted = await state(page);
  assert.ok(distance(shifted.pivot, nearer.pivot) > 0.01);
  await page.keyboard.press("r");
  await until(page, "player.camera !== '' && !inside.stage.navigation.jumping");
  const back = await state(page);
  assert.ok(distance(back.centre, before.centre) < 1e-9);
  assert.equal(back.camera, before.camera);
  assert.deepEqual(page.complaints, []);
  await page.context().close();
});

test("a hand stops where the fence stands, whose address is part of the page's", async () => {
  const page = await browser.opened("dome", { width: 640, height: 400 });
  await ready(page);
  const { centre, axes, up } = await state(page);
  const right = axes[0];
  const forward = [0, 1, 2].map((i) => right[(i + 1) % 3] * up[(i + 2) % 3] - right[(i + 2) % 3] * up[(i + 1) % 3]);
  const along = (axis, place) => axis.reduce((sum, part, i) => sum + part * place[i], 0);
  const [x, y] = [along(right, centre), along(forward, centre)];
  // Admitted is a square of a side of .4 around the camera, of a wider map.
  const fence = { axes: [right, forward], low: [x - 0.6, y - 0.6], high: [x + 0.6, y + 0.6], within: [0, 1, 2].map((row) => [false, row === 1, false]) };
  await page.context().route("**/fence.json", (route) => route.fulfill({ json: fence }));
  const fenced = await page.context().newPage();
  await fenced.setViewportSize({ width: 640, height: 400 });
  const address = new URL(page.url());
  address.searchParams.set("fence", "fence.json");
  await fenced.goto(address.href);
  await until(fenced, "player.info !== null && player[Symbol.for('decogs.inside')].stage.navigation.fence !== null");
  const far = [];
  for (const each of [page, fenced]) {
    await dragged(each, 250, 0);
    far.push(Math.abs(along(right, (await state(each)).centre) - x));
  }
  assert.ok(far[0] > 0.3, `without a fence: ${far[0]}`);
  assert.ok(far[1] > 0.02 && far[1] <= 0.2 + 1e-9, `within the fence: ${far[1]}`);
  await page.context().close();
});

test("the timeline shows the keyframe below the pointer, from where the scene is looked at", async () => {
  const page = await browser.opened("long", { width: 640, height: 400, query: "&camera=turned" });
  await ready(page);
  await until(page, "player.shadowRoot.querySelector('.bar') !== null && player.bufferedFrames.some(([from, to]) => from <= 120 && to > 120)");
  const box = await page.locator(".timeline").boundingBox();
  await page.mouse.move(box.x + (box.width * 130.5) / 300, box.y + box.height / 2);
  await until(page, "!player.shadowRoot.querySelector('.tip canvas').hidden");
  assert.equal(await page.evaluate(() => document.querySelector("decogs-player").info.frame), 0);
  const found = await pixelsOf(page, await page.evaluate(() => document.querySelector("decogs-player").shadowRoot.querySelector(".tip canvas").toDataURL()));
  assert.equal(found.width, 160);
  await show(page, 120);
  const decibels = psnr(found, await picture(page, found.width, found.height));
  assert.ok(decibels > 40, `${decibels.toFixed(1)} dB`);
  // It belongs to the view.
  await page.evaluate(() => {
    const player = document.querySelector("decogs-player");
    globalThis.before = player.shadowRoot.querySelector(".tip canvas").toDataURL();
    player.camera = "cam00";
  });
  await until(page, "!inside.stage.navigation.jumping");
  await page.mouse.move(box.x + (box.width * 131.5) / 300, box.y + box.height / 2);
  await until(page, "player.shadowRoot.querySelector('.tip canvas').toDataURL() !== globalThis.before");
  assert.deepEqual(page.complaints, []);
  await page.context().close();
});

test("a lower quality draws fewer pixels and fewer Gaussians, those that cover least left out", async () => {
  const page = await browser.opened("degree1", { width: 640, height: 400, query: "&quality=0.5" });
  await ready(page);
  await until(page, "player.figures?.width === 453 && player.figures.height === 283 && player.shadowRoot.querySelector('.bar') !== null");
  await show(page, 3);
  const figures = () => page.evaluate(() => document.querySelector("decogs-player").figures);
  const half = await figures();
  const thinned = await picture(page, 320, 200);
  await page.locator("[name=menu]").click();
  assert.equal(await page.locator("[name=quality]").inputValue(), "0.5");
  await page.locator("[name=quality]").selectOption("1");
  await until(page, `player.figures.width === 640 && player.figures.drawn > ${half.drawn}`);
  const whole = await figures();
  assert.ok(half.drawn > 0.65 * whole.drawn && half.drawn < 0.9 * whole.drawn, `${half.drawn} of ${whole.drawn}`);
  const decibels = psnr(thinned, await picture(page, 320, 200));
  assert.ok(decibels > 24 && decibels < 60, `${decibels.toFixed(1)} dB`);
  assert.deepEqual(page.complaints, []);
  await page.context().close();
});

test("what is to stay is drawn over the scene, and becomes a command", async () => {
  const page = await browser.opened("degree1", { width: 640, height: 480 });
  await ready(page);
  await until(page, "player.shadowRoot.querySelector('.bar') !== null");
  await page.locator("[name=menu]").click();
  await page.locator("[name=crop]").click();
  await page.locator(".crop canvas.drawing").waitFor();
  const draw = async (from, to) => {
    await page.mouse.move(...from);
    await page.mouse.down();
    await page.mouse.move(...to, { steps: 3 });
    await page.mouse.up();
  };
  const number = String.raw`-?\d+(?:\.\d+)?`;
  const vector = `${number},${number},${number}`;
  const command = () => page.locator(".crop output").textContent();
  await draw([250, 200], [400, 300]);
  assert.match(await command(), new RegExp(`^decogs-edit degree1.dgs -o cropped.dgs crop box ${vector} ${vector}$`));
  // Now dragging moves the camera again, and the box stays.
  const first = await command();
  const before = await state(page);
  await draw([300, 240], [380, 240]);
  await page.waitForTimeout(400);
  assert.notDeepEqual((await state(page)).centre, before.centre);
  assert.equal(await command(), first);
  await page.locator(".crop [name=shape]").selectOption("sphere");
  await draw([320, 240], [380, 240]);
  assert.match(await command(), new RegExp(`crop sphere ${vector} ${number}$`));
  await page.locator(".crop [name=done]").click();
  assert.equal(await page.locator(".crop").isVisible(), false);
  assert.deepEqual(page.complaints, []);
  await page.context().close();
});

test("X marks a loop, whichever end comes first", async () => {
  const page = await browser.opened("long", { width: 640, height: 400 });
  await ready(page);
  await until(page, "player.shadowRoot.querySelector('.bar') !== null");
  const range = () => page.evaluate(() => document.querySelector("decogs-player").range);
  await show(page, 8);
  await page.keyboard.press("x");
  await show(page, 3);
  await page.keyboard.press("x");
  assert.deepEqual(await range(), [3, 9]);
  await page.keyboard.press("x");
  assert.equal(await range(), null);
  assert.deepEqual(page.complaints, []);
  await page.context().close();
});

test("keys play, step, fly and change cameras", async () => {
  const page = await browser.opened("long", { width: 640, height: 400 });
  await ready(page);
  await page.keyboard.press("ArrowRight");
  await until(page, "player.info.frame === 1");
  await page.keyboard.press("Shift+ArrowRight");
  await until(page, "player.info.frame === 60");
  await page.keyboard.press("Home");
  await until(page, "player.info.frame === 0");
  await page.keyboard.press("]");
  await until(page, "player.camera === 'off centre'");
  await page.keyboard.press("[");
  await until(page, "player.camera === 'cam00'");
  await page.keyboard.press("Space");
  await until(page, "!player.paused");
  await page.keyboard.press("Space");
  await until(page, "player.paused");
  await page.waitForTimeout(700); // the jump between the cameras is over
  const before = await state(page);
  await page.keyboard.down("w");
  await page.waitForTimeout(400);
  await page.keyboard.up("w");
  await page.waitForTimeout(600);
  const after = await state(page);
  const ahead = before.axes[2].reduce((sum, part, i) => sum + part * (after.centre[i] - before.centre[i]), 0);
  assert.ok(ahead > 0.005, `${ahead}`);
  await page.keyboard.press("?");
  await until(page, "!player.shadowRoot.querySelector('.help').hidden");
  await page.keyboard.press("Escape");
  await until(page, "player.shadowRoot.querySelector('.help').hidden");
  await page.context().close();
});

test("digits go to tenths of the time, comma and full stop step", async () => {
  const page = await browser.opened("long", { width: 640, height: 400 });
  await ready(page);
  await until(page, "player.frames.count === 300");
  await page.keyboard.press("5");
  await until(page, "player.info.frame === 150");
  await page.keyboard.press(",");
  await until(page, "player.info.frame === 149");
  await page.keyboard.press(".");
  await until(page, "player.info.frame === 150");
  await page.context().close();
});

test("people are told that they may turn the picture, which turns by itself until they do", async () => {
  const page = await browser.opened("dome", { width: 640, height: 400, query: "&orbit" });
  await ready(page);
  await until(page, "/Drag to look around/.test(player.shadowRoot.querySelector('.notice')?.textContent)");
  const before = await state(page);
  await until(page, `Math.hypot(...player.view.pose.centre.map((value, i) => value - [${before.centre}][i])) > 0.02`);
  await dragged(page, 60, 0);
  await rested(page);
  const after = await state(page);
  await page.waitForTimeout(400);
  assert.deepEqual((await state(page)).centre, after.centre);
  await page.context().close();
});

test("the timeline's words stand where the pointer is, in a page that shows the player smaller, too", async () => {
  const page = await browser.opened("long", { width: 640, height: 400 });
  await ready(page);
  await until(page, "player.shadowRoot.querySelector('.bar') !== null");
  await page.evaluate(() => (document.querySelector("decogs-player").style.cssText = "transform: scale(.5); transform-origin: 0 0"));
  const track = await page.locator(".timeline").boundingBox();
  await page.mouse.move(track.x + track.width / 2, track.y + 3);
  await page.locator(".tip").waitFor();
  const tip = await page.locator(".tip").boundingBox();
  assert.ok(Math.abs(tip.x + tip.width / 2 - (track.x + track.width / 2)) < 2, `${tip.x}, ${tip.width}`);
  await page.context().close();
});

test("an error with a long address stays in the player", async () => {
  const page = await browser.opened("x".repeat(200), { width: 320, height: 300 });
  await until(page, "player.error !== null && player.shadowRoot.querySelector('.notice')?.checkVisibility()");
  const [inner, outer] = await page.evaluate(() => { const { scrollWidth, clientWidth } = document.querySelector("decogs-player").shadowRoot.querySelector(".notice"); return [scrollWidth, clientWidth]; });
  assert.ok(inner <= outer, `${inner} in ${outer}`);
  await page.context().close();
});

test("the menu shows speeds and qualities that only the page has chosen", async () => {
  const page = await browser.opened("long", { width: 640, height: 400, query: "&quality=0.3" });
  await ready(page);
  await page.evaluate(() => (document.querySelector("decogs-player").playbackRate = 1.5));
  await page.locator("[name=menu]").click();
  await until(page, "player.shadowRoot.querySelector('[name=rate]').value === '1.5'");
  const shown = (name) => page.evaluate((name) => document.querySelector("decogs-player").shadowRoot.querySelector(`[name=${name}]`).selectedOptions[0]?.text, name);
  assert.deepEqual([await shown("rate"), await shown("quality")], ["1.5 ×", "30 %"]);
  await page.locator("[name=rate]").selectOption("2");
  assert.equal(await page.evaluate(() => document.querySelector("decogs-player").playbackRate), 2);
  await page.context().close();
});

test("an invitation gives way to the menu, which fades where it goes on", async () => {
  const page = await browser.opened("long", { width: 320, height: 400 });
  await ready(page);
  await until(page, "!player.shadowRoot.querySelector('.notice')?.hidden");
  await page.locator("[name=menu]").click();
  assert.equal(await page.locator(".notice").isVisible(), false);
  await page.waitForFunction(() => getComputedStyle(document.querySelector("decogs-player").shadowRoot.querySelector(".menu")).maskImage.includes("gradient"));
  await page.evaluate(() => document.querySelector("decogs-player").shadowRoot.querySelector(".menu").scrollTo(0, 10_000));
  await page.waitForFunction(() => getComputedStyle(document.querySelector("decogs-player").shadowRoot.querySelector(".menu")).maskImage === "none");
  assert.deepEqual(page.complaints, []);
  await page.context().close();
});

test("the menu copies code that shows the page at this view in another one", async () => {
  const page = await browser.opened("long", { width: 640, height: 480 });
  await page.context().grantPermissions(["clipboard-read", "clipboard-write"]);
  await ready(page);
  await show(page, 7);
  await page.locator("[name=menu]").click();
  await page.locator("[name=embed]").click();
  await until(page, "/Copied/.test(player.shadowRoot.querySelector('.notice').textContent)");
  const code = await page.evaluate(() => navigator.clipboard.readText());
  await page.setContent(code);
  const frame = await (await page.locator("iframe").elementHandle()).contentFrame();
  await until(frame, "player?.info?.frame === 7");
  await page.context().close();
});

test("the bar: play, timeline, cameras, menu, and names for screen readers", async () => {
  const page = await browser.opened("long", { width: 640, height: 400 });
  await ready(page);
  await until(page, "player.frames.count === 300");
  const track = await page.locator(".timeline").boundingBox();
  await page.mouse.click(track.x + track.width * 0.5, track.y + track.height / 2);
  await until(page, "player.info.frame === 150");
  await page.locator("[name=camera]").selectOption({ label: "turned" });
  await until(page, "player.camera === 'turned'");
  await page.locator("[name=menu]").click();
  await page.locator("[name=overlay]").selectOption("changes");
  await until(page, "player.overlay === 'changes'");
  await page.locator("[name=figures]").check();
  await until(page, "player.shadowRoot.querySelector('.figures').textContent.includes('Gaussians')");
  await page.locator("button.play").click();
  await until(page, "!player.paused");
  await page.locator("button.play").click();
  const unnamed = await page.evaluate(() => {
    const { shadowRoot } = document.querySelector("decogs-player");
    const controls = [...shadowRoot.querySelectorAll("button, select, input, [role=slider]")];
    return controls.filter((each) => !(each.ariaLabel || each.textContent.trim() || each.closest("label"))).length;
  });
  assert.equal(unnamed, 0);
  const slider = await page.locator(".timeline").getAttribute("aria-valuetext");
  assert.match(slider, /frame \d+ of 300/);
  await page.context().close();
});

test("what changed is seen after a seek as after playing", async () => {
  const page = await browser.opened("long", { width: 200, height: 150 });
  await ready(page);
  const heat = async () => {
    await page.evaluate(() => (document.querySelector("decogs-player").overlay = "changes"));
    await rested(page);
    return page.evaluate(async () => (await document.querySelector("decogs-player").capture(200, 150)).size);
  };
  await page.evaluate(() => (document.querySelector("decogs-player").currentFrame = 64));
  await until(page, "player.info.frame === 64");
  const jumped = await heat();
  for (const frame of [62, 63, 64]) {
    await page.evaluate((frame) => (document.querySelector("decogs-player").currentFrame = frame), frame);
    await until(page, `player.info.frame === ${frame}`);
  }
  assert.equal(await heat(), jumped);
  await page.context().close();
});

test("nothing sticks out of a phone's screen", async () => {
  const page = await browser.opened("long", { width: 390, height: 844 });
  await ready(page);
  await page.locator("[name=menu]").click();
  const out = await page.evaluate(() => {
    const { shadowRoot } = document.querySelector("decogs-player");
    const shown = [...shadowRoot.querySelectorAll(".panel:not([hidden]), .row > *, .row button")];
    return shown.filter((each) => {
      const { left, right, top, bottom } = each.getBoundingClientRect();
      return left < 0 || top < 0 || right > innerWidth || bottom > innerHeight;
    }).map((each) => each.className || each.name);
  });
  assert.deepEqual(out, []);
  assert.ok(await page.evaluate(() => document.documentElement.scrollWidth <= innerWidth));
  await page.context().close();
});

test("nothing is drawn while nothing changes", async () => {
  const page = await browser.opened("arc");
  await ready(page);
  await rested(page);
  await page.waitForTimeout(500);
  const drawn = () => page.evaluate(() => document.querySelector("decogs-player")[Symbol.for("decogs.inside")].ticking);
  assert.equal(await drawn(), 0);
  await page.context().close();
});

test("the recorded picture lies left of a line, as large as the camera's, and follows the frame", async () => {
  const page = await browser.opened("recorded", { width: 400, height: 300, query: "&camera=barrel" });
  const asked = [];
  await page.route("**/recorded/**", async (route) => {
    const { pathname } = new URL(route.request().url());
    asked.push(pathname);
    if (pathname.includes("fisheye")) await new Promise((done) => setTimeout(done, 2000));
    const svg = '<svg xmlns="http://www.w3.org/2000/svg" width="200" height="150"><rect width="200" height="150" fill="#f0f"/></svg>';
    await route.fulfill({ contentType: "image/svg+xml", body: svg });
  });
  await ready(page);
  const withoutRig = await page.evaluate(() => {
    const player = document.querySelector("decogs-player");
    player.comparing = true;
    return player.comparing;
  });
  assert.equal(withoutRig, false);
  await page.evaluate(() => document.querySelector("decogs-player").setAttribute("recordings", "/recorded/{camera}/{frame}.jpg"));
  await page.keyboard.press("b");
  await until(page, "player.comparing && player.recorded && !player.shadowRoot.querySelector('.recording').hidden");
  await page.waitForTimeout(300);
  const seen = () =>
    page.evaluate(() => {
      const { shadowRoot } = document.querySelector("decogs-player");
      const image = shadowRoot.querySelector(".recording img");
      const { left, top, width, height } = image.getBoundingClientRect();
      return { left, top, width, height, clip: image.style.clipPath, address: new URL(image.src).pathname };
    });
  assert.deepEqual(await seen(), { left: 0, top: 0, width: 400, height: 300, clip: "inset(0px 50% 0px 0px)", address: "/recorded/barrel/0.jpg" });
  const line = await page.locator(".divider").boundingBox();
  await page.mouse.move(line.x + line.width / 2, 130);
  await page.mouse.down();
  await page.mouse.move(100, 130, { steps: 3 });
  await page.mouse.up();
  assert.equal((await seen()).clip, "inset(0px 75% 0px 0px)");
  assert.equal(await page.evaluate(() => document.querySelector("decogs-player").camera), "barrel");
  await page.evaluate(() => (document.querySelector("decogs-player").currentFrame = 1));
  await until(page, "player.info.frame === 1");
  await page.waitForTimeout(300);
  assert.equal((await seen()).address, "/recorded/barrel/1.jpg");
  // Looked at from elsewhere, and back: the picture is still there.
  const shown = "!player.shadowRoot.querySelector('.recording').hidden && !player.shadowRoot.querySelector('.recording img').hidden";
  await page.mouse.move(300, 100);
  await page.mouse.wheel(0, 100);
  await until(page, "player.camera === '' && player.shadowRoot.querySelector('.recording').hidden");
  await page.keyboard.press("r");
  await until(page, `player.camera === 'barrel' && ${shown}`);
  // That of the camera before does not lie over this one's view while its own is on its way.
  await page.keyboard.press("]");
  await until(page, "player.camera === 'fisheye' && !inside.stage.navigation.jumping");
  await until(page, "player.shadowRoot.querySelector('.recording img').hidden", 1500);
  await until(page, `player.camera === 'fisheye' && ${shown}`);
  assert.equal((await seen()).address, "/recorded/fisheye/1.jpg");
  await page.keyboard.press("b");
  await until(page, "player.shadowRoot.querySelector('.recording').hidden");
  assert.deepEqual(page.complaints, []);
  await page.context().close();
});

/** Fingers that come down, move to other places in steps, and go. */
async function fingers(page, from, to) {
  const client = await page.context().newCDPSession(page);
  const touch = (type, points) => client.send("Input.dispatchTouchEvent", { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });
  await touch("touchStart", from);
  for (let step = 1; step <= 5; step++) {
    await touch("touchMove", from.map(([x, y], i) => [x + ((to[i][0] - x) * step) / 5, y + ((to[i][1] - y) * step) / 5]));
  }
  await touch("touchEnd", []);
  await page.waitForTimeout(900);
}

test("touch: one finger circles, two shift, a pinch goes nearer", async () => {
  const page = await browser.opened("dome", { width: 390, height: 600, touch: true });
  await ready(page);
  const before = await state(page);
  await fingers(page, [[200, 200]], [[280, 200]]);
  const circled = await state(page);
  assert.ok(distance(circled.centre, before.centre) > 0.05, "circled");
  assert.ok(Math.abs(distance(circled.centre, circled.pivot) - distance(before.centre, before.pivot)) < 1e-6);
  await fingers(page, [[150, 200], [250, 200]], [[200, 240], [300, 240]]);
  const shifted = await state(page);
  assert.ok(distance(shifted.pivot, circled.pivot) > 0.01, "shifted");
  await fingers(page, [[170, 200], [230, 200]], [[100, 200], [300, 200]]);
  const nearer = await state(page);
  assert.ok(distance(nearer.centre, nearer.pivot) < 0.8 * distance(shifted.centre, shifted.pivot), "nearer");
  assert.deepEqual(page.complaints, []);
  await page.context().close();
});

test("a hidden tab pauses, and goes on when it is seen again", async () => {
  const page = await browser.opened("long", { query: "&loop" });
  await ready(page);
  // Headless pages are never hidden: the browser's own word for it is replaced.
  const hide = (hidden) =>
    page.evaluate((hidden) => {
      Object.defineProperty(document, "hidden", { value: hidden, configurable: true });
      document.dispatchEvent(new Event("visibilitychange"));
      return document.querySelector("decogs-player").paused;
    }, hidden);
  await page.evaluate(() => document.querySelector("decogs-player").play());
  await until(page, "player.info.frame >= 3");
  assert.equal(await hide(true), true);
  const at = await page.evaluate(() => document.querySelector("decogs-player").currentTime);
  await page.waitForTimeout(400);
  assert.equal(await page.evaluate(() => document.querySelector("decogs-player").currentTime), at);
  assert.equal(await hide(false), false);
  // Who paused it goes on being obeyed.
  await page.evaluate(() => document.querySelector("decogs-player").pause());
  await hide(true);
  assert.equal(await hide(false), true);
  await page.context().close();
});
