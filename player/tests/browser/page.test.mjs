// The element in a page that others wrote: moved about, opened from the disk, in small places.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { PLAYER, picture, psnr, ready, show, started, until } from "./harness.mjs";

let browser;
before(async () => (browser = await started()));
after(() => browser.close());

/** Looks from beside, so that a view that was forgotten shows. */
const lookAside = (page) =>
  page.evaluate(() => {
    const player = document.querySelector("decogs-player");
    const { worldToCamera: rows, ...lens } = player.currentCamera(200, 150);
    player.lookFrom({ axes: rows.map((row) => row.slice(0, 3)), centre: [0.3, 0.1, -0.2] }, lens);
  });

for (const [how, move] of [
  ["moved to another place", () => {
    const place = document.createElement("div");
    document.body.append(place);
    place.append(document.querySelector("decogs-player"));
  }],
  ["taken out and put in again later", async () => {
    const player = document.querySelector("decogs-player");
    player.remove();
    await new Promise((done) => setTimeout(done, 100));
    document.body.append(player);
  }],
]) {
  test(`an element that is ${how} keeps frame, camera and picture`, async () => {
    const page = await browser.opened("long");
    await ready(page);
    await show(page, 61);
    await lookAside(page);
    await until(page, "!inside.stage.pending && !inside.stage.renderer.busy");
    const before = await picture(page, 200, 150);
    await page.evaluate(move);
    await until(page, "player.info?.frame === 61 && !inside.stage.pending && !inside.stage.renderer.busy");
    assert.ok(psnr(await picture(page, 200, 150), before) > 60);
    assert.equal(await page.evaluate(() => document.querySelector("decogs-player").camera), "");
    await show(page, 62);
    assert.deepEqual(page.complaints, []);
    await page.context().close();
  });
}

test("an element that is moved while it plays goes on, and begins anew with another stream", async () => {
  const page = await browser.opened("long", { query: "&loop" });
  await ready(page);
  const told = await page.evaluate(async () => {
    const player = document.querySelector("decogs-player");
    const next = (name) => new Promise((done) => player.addEventListener(name, done, { once: true }));
    await player.play();
    document.body.prepend(player);
    const { paused, error } = player;
    player.remove();
    player.src = "/data/degree1.dgs";
    document.body.append(player);
    await next("loadeddata");
    return [paused, error, player.frames.count, player.info.frame];
  });
  assert.deepEqual(told.slice(0, 2), [false, null]);
  assert.equal(told[3], 0);
  await page.context().close();
});

test("opened from the disk, or without its script, the page says what to do", async () => {
  const context = await browser.browser.newContext();
  const disk = await context.newPage();
  await disk.goto(`file://${process.env.DECOGS_PAGE}/index.html`);
  await disk.locator("text=python3 -m http.server").waitFor({ state: "visible" });
  const lost = await context.newPage();
  await lost.route("**/decogs-player.js", (route) => route.fulfill({ status: 404 }));
  await lost.goto(`${browser.server.address}/page/index.html?src=/data/long.dgs`);
  await lost.locator("text=must lie beside this page").waitFor({ state: "visible" });
  await context.close();
});

test("a worker that does not come is told, long after its script was asked for as well", async () => {
  const page = await browser.own(`<!doctype html>${PLAYER}<decogs-player controls></decogs-player>`);
  await page.route("**/decogs-worker.js", (route) => route.fulfill({ status: 404 }));
  const asked = page.waitForResponse("**/decogs-worker.js");
  await page.reload();
  await asked;
  await page.waitForTimeout(300);
  const told = await page.evaluate(() => {
    const player = document.querySelector("decogs-player");
    player.src = "/data/long.dgs";
    return Promise.race([new Promise((done) => player.addEventListener("error", () => done(player.error), { once: true })), new Promise((done) => setTimeout(done, 20_000))]);
  });
  assert.match(String(told), /decogs-worker\.js/);
  await page.context().close();
});

test("a graphics card that is lost for good gives way to the exact picture", async () => {
  const page = await browser.opened("long");
  await ready(page);
  await page.evaluate(() => {
    const { stage } = document.querySelector("decogs-player")[Symbol.for("decogs.inside")] ?? document.querySelector("decogs-player");
    stage.renderer.canvas.getContext("webgl2").getExtension("WEBGL_lose_context").loseContext();
  });
  await until(page, "player.exact && !player.canChooseExact && !inside.stage.pending && !inside.stage.renderer.busy");
  await show(page, 61);
  assert.equal((await picture(page, 200, 150)).width, 200);
  await page.context().close();
});

const PLACES = [[667, 320, true], [740, 360, true], [360, 640, true], [375, 667, true], [320, 568, true], [320, 180, false], [640, 360, false]];
for (const [width, height, touch] of PLACES) {
  test(`all of bar and menu can be reached in ${width}x${height}${touch ? ", by finger" : ""}`, async () => {
    const page = await browser.opened("long", { width, height, touch });
    await ready(page);
    await until(page, "player.shadowRoot.querySelector('[name=camera] option')");
    const stray = (selector) =>
      page.evaluate((selector) => {
        const shown = [...document.querySelector("decogs-player").shadowRoot.querySelectorAll(selector)].filter((each) => each.checkVisibility());
        return shown.filter((each) => {
          each.scrollIntoView({ block: "nearest" });
          const { left, right, top, bottom } = each.getBoundingClientRect();
          const seen = each.getRootNode().elementFromPoint((left + right) / 2, (top + bottom) / 2);
          return left < 0 || top < 0 || right > innerWidth || bottom > innerHeight || !(each.contains(seen) || seen?.contains(each));
        }).map((each) => each.className || each.name || each.textContent);
      }, selector);
    assert.deepEqual(await stray(".row button, .row select, .timeline"), []);
    assert.ok((await page.locator("[name=full]").boundingBox()).width >= 36);
    await page.locator("[name=menu]").click();
    assert.deepEqual(await stray(".menu label, .menu button"), []);
    await page.context().close();
  });
}

test("Escape closes the menu from a field, and the focus goes back to what opened it", async () => {
  const page = await browser.opened("long", { width: 640, height: 480 });
  await ready(page);
  await page.locator("[name=menu]").click();
  await page.locator("[name=overlay]").focus();
  await page.keyboard.press("Escape");
  await until(page, "player.shadowRoot.querySelector('.menu').hidden");
  assert.equal(await page.evaluate(() => document.querySelector("decogs-player").shadowRoot.activeElement?.name), "menu");
  await page.evaluate(() => document.querySelector("decogs-player").focus());
  await page.keyboard.press("?");
  await until(page, "!player.shadowRoot.querySelector('.help').hidden");
  await page.keyboard.press("Escape");
  assert.equal(await page.evaluate(() => document.activeElement.tagName), "DECOGS-PLAYER");
  await page.keyboard.press("ArrowRight");
  await until(page, "player.info.frame === 1");
  await page.context().close();
});

test("where elements get no full screen, the player fills the window, and Escape leaves it", async () => {
  const page = await browser.own(`<!doctype html><style>decogs-player { width: 200px; margin: 50px }</style><script>delete Element.prototype.requestFullscreen</script>${PLAYER}<decogs-player controls src="/data/long.dgs"></decogs-player>`);
  await ready(page);
  await page.locator("[name=full]").click();
  const size = () => page.evaluate(() => [document.querySelector("decogs-player").clientWidth, document.querySelector("decogs-player").clientHeight]);
  await until(page, "player.clientWidth === 400");
  assert.deepEqual(await size(), [400, 300]);
  await page.keyboard.press("Escape");
  await until(page, "player.clientWidth === 200");
  assert.deepEqual(page.complaints, []);
  await page.context().close();
});

test("with cooperative gestures the wheel and one finger scroll the page; Ctrl and two fingers move the camera", async () => {
  const html = `<!doctype html><meta name="viewport" content="width=device-width">${PLAYER}<decogs-player gestures="cooperative" style="width: 100%; height: 260px" src="/data/dome.dgs"></decogs-player><div style="height: 2000px"></div>`;
  const page = await browser.own(html, { hasTouch: true, isMobile: true });
  await ready(page);
  await until(page, "player.shadowRoot.querySelector('.notice') !== null");
  const at = () => page.evaluate(() => [scrollY, ...document.querySelector("decogs-player").view.pose.centre]);
  const before = await at();
  await page.mouse.move(200, 100);
  await page.mouse.wheel(0, 80);
  await page.waitForFunction(() => scrollY > 40);
  assert.match(await page.locator(".notice").textContent(), /Ctrl/);
  await page.evaluate(() => scrollTo(0, 0));
  const client = await page.context().newCDPSession(page);
  const touch = (type, points) => client.send("Input.dispatchTouchEvent", { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });
  const swipe = async (from, step) => {
    await touch("touchStart", from);
    for (let i = 1; i <= 6; i++) await touch("touchMove", from.map(([x, y]) => [x + i * step[0], y + i * step[1]]));
    await touch("touchEnd", []);
    await page.waitForTimeout(600);
  };
  await swipe([[200, 200]], [0, -20]);
  const scrolled = await at();
  assert.ok(scrolled[0] > 40, `scrolled by ${scrolled[0]}`);
  assert.deepEqual(scrolled.slice(1), before.slice(1));
  await page.evaluate(() => scrollTo(0, 0));
  await swipe([[150, 100], [250, 100]], [15, 0]);
  const circled = await at();
  assert.ok(Math.hypot(...circled.slice(1).map((value, i) => value - before[i + 1])) > 0.05, "circled");
  await page.context().close();
});

test("in another document, which forgets what was adopted, the player has its looks and goes on", async () => {
  const page = await browser.opened("long", { width: 400, height: 300, query: "&loop" });
  await ready(page);
  await until(page, "player.shadowRoot.querySelector('.bar') !== null");
  const told = await page.evaluate(async () => {
    const player = document.querySelector("decogs-player");
    const place = document.body.appendChild(document.createElement("iframe"));
    await player.play();
    place.contentDocument.body.append(player);
    const { frame } = player.info;
    const frames = async (count) => {
      for (let frames = 0; frames < count; frames++) await new Promise((done) => player.addEventListener("timeupdate", done, { once: true }));
    };
    await frames(5);
    const [inner, bar] = [player.getBoundingClientRect(), player.shadowRoot.querySelector(".bar")];
    const told = [inner.width / inner.height, getComputedStyle(bar).position, player.info.frame !== frame, player.error];
    // And back, when the other window is no more.
    place.contentWindow.requestAnimationFrame = () => 1;
    await new Promise((done) => setTimeout(done, 200));
    document.body.append(player);
    place.remove();
    await frames(3);
    return told;
  });
  assert.ok(Math.abs(told[0] - 16 / 9) < 0.02, `${told[0]}`);
  assert.deepEqual(told.slice(1), ["absolute", true, null]);
  assert.deepEqual(page.complaints, []);
  await page.context().close();
});

test("screen readers hear a stream's title, unless the page has another name", async () => {
  const page = await browser.own(`<!doctype html>${PLAYER}<decogs-player src="/data/shown0.dgs"></decogs-player><decogs-player src="/data/shown0.dgs" aria-label="Mine"></decogs-player>`);
  const names = () => page.evaluate(() => [...document.querySelectorAll("decogs-player")].map((player) => player.ariaLabel));
  await page.waitForFunction(() => [...document.querySelectorAll("decogs-player")].every(({ info }) => info));
  assert.deepEqual(await names(), ["Three <cameras> & a ball", "Mine"]);
  await page.evaluate(() => (document.querySelector("decogs-player").src = "/data/degree1.dgs"));
  await until(page, "player.info !== null && player.header.presentation.title === ''");
  assert.deepEqual(await names(), ["Free-viewpoint video", "Mine"]);
  await page.context().close();
});

test("other pixels of the screen make another picture", async () => {
  const page = await browser.opened("long", { width: 300, height: 200 });
  await ready(page);
  await until(page, "inside.stage.renderer.canvas.width === 300");
  const client = await page.context().newCDPSession(page);
  // Chromium tells of emulated pixels only together with something else, here of another kind of device.
  await client.send("Emulation.setDeviceMetricsOverride", { width: 300, height: 200, deviceScaleFactor: 2, mobile: true });
  await until(page, "inside.stage.renderer.canvas.width === 600");
  await page.context().close();
});

test("in a page that goes from right to left, times and speeds are still read from left to right", async () => {
  const page = await browser.own(`<!doctype html><html dir="rtl">${PLAYER}<decogs-player controls src="/data/long.dgs"></decogs-player></html>`, { width: 640 });
  await ready(page);
  await until(page, "player.shadowRoot.querySelector('.of')?.textContent");
  const [now, of] = await page.evaluate(() => [".now-at", ".of"].map((each) => document.querySelector("decogs-player").shadowRoot.querySelector(each).getBoundingClientRect().left));
  assert.ok(now < of, `${now} and ${of}`);
  await page.context().close();
});

test("with colours of the system's own, nothing shines through, and the legend keeps its colours", async () => {
  const page = await browser.opened("long", { width: 640, height: 400 });
  await page.emulateMedia({ forcedColors: "active" });
  await ready(page);
  await until(page, "player.shadowRoot.querySelector('.bar') !== null");
  await page.evaluate(() => (document.querySelector("decogs-player").overlay = "changes"));
  await until(page, "!player.shadowRoot.querySelector('.legend').hidden");
  const colours = await page.evaluate(() => {
    const { shadowRoot } = document.querySelector("decogs-player");
    return [".bar", ".now", ".past"].map((each) => getComputedStyle(shadowRoot.querySelector(each)).backgroundColor);
  });
  assert.match(colours[0], /^rgb\(/, "no alpha");
  assert.deepEqual(colours.slice(1), ["rgb(255, 219, 115)", "rgb(237, 71, 33)"]);
  await page.context().close();
});

test("in a place for little more than a picture, what there is can be reached", async () => {
  const page = await browser.opened("long", { width: 160, height: 90 });
  await ready(page);
  await until(page, "player.shadowRoot.querySelector('.bar') !== null");
  const out = await page.evaluate(() => {
    const { shadowRoot } = document.querySelector("decogs-player");
    const shown = [...shadowRoot.querySelectorAll(".bar, .row > *, .notice")].filter((each) => each.checkVisibility());
    return shown.filter((each) => {
      const { left, right, top, bottom } = each.getBoundingClientRect();
      return left < 0 || top < 0 || right > innerWidth || bottom > innerHeight;
    }).map((each) => each.className || each.name);
  });
  assert.deepEqual(out, []);
  await page.locator(".play").click();
  await until(page, "!player.paused");
  await page.context().close();
});

test("zooming out ends, and what is no overlay is refused", async () => {
  const page = await browser.opened("dome");
  await ready(page);
  await page.mouse.move(100, 12);
  for (let i = 0; i < 60; i++) await page.mouse.wheel(0, 400);
  await page.waitForTimeout(900);
  const [distance, refused] = await page.evaluate(() => {
    const player = document.querySelector("decogs-player");
    const { pose, pivot, size } = (player[Symbol.for("decogs.inside")] ?? player).stage.navigation;
    try {
      player.overlay = "bogus";
    } catch (error) {
      return [Math.hypot(...pose.centre.map((value, i) => value - pivot[i])) / size, error.name];
    }
    return [0, null];
  });
  assert.ok(distance > 5 && distance < 9, `${distance}`);
  assert.equal(refused, "RangeError");
  await page.context().close();
});
