// The manners of <video>: properties that come before the element, the poster, what is read beforehand, callbacks of frames, off screen.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { PLAYER, ready, show, started, until } from "./harness.mjs";

let browser;
before(async () => (browser = await started()));
after(() => browser.close());

const POSTER = "data:image/svg+xml,%3Csvg xmlns='http://www.w3.org/2000/svg' width='40' height='30'%3E%3Crect width='40' height='30' fill='red'/%3E%3C/svg%3E";
const element = (attributes) => `<!doctype html><meta charset="utf-8"><style>body { margin: 0 }</style>${PLAYER}<decogs-player exact="off" ${attributes}></decogs-player>`;
const posterSeen = (page) => page.evaluate(() => document.querySelector("decogs-player").shadowRoot.querySelector(".poster").checkVisibility());
/** A page's workers are its own: their messages are noted. */
const noting = () => {
  globalThis.workers = new Set();
  globalThis.sent = [];
  const { postMessage } = Worker.prototype;
  Worker.prototype.postMessage = function (...message) {
    globalThis.workers.add(this);
    globalThis.sent.push(message[0]);
    postMessage.apply(this, message);
  };
};
const drawn = (page) => page.evaluate(() => document.querySelector("decogs-player")[Symbol.for("decogs.inside")].stage.drawnAt.at(-1) ?? 0);

test("what a page sets before the element is defined counts, as what it sets then", async () => {
  // The element is asked for after that, as scripts are that come late.
  const early = `<script>
    const player = document.body.appendChild(document.createElement("decogs-player"));
    Object.assign(player, { exact: false, loop: true, controls: true, src: "/data/long.dgs", muted: true, volume: 0.25, playbackRate: 2, camera: "turned", overlay: "changes", range: [3, 9], currentFrame: 5, quality: 0.5, paused: false });
  </script>`;
  const page = await browser.own(`<!doctype html><body>${early}${PLAYER}`);
  await ready(page);
  const told = await page.evaluate(() => {
    const player = document.querySelector("decogs-player");
    const { exact, loop, controls, muted, volume, playbackRate, camera, overlay, range, quality, paused, currentFrame } = player;
    return { own: Object.keys(player), exact, loop, controls, muted, volume, playbackRate, camera, overlay, range, quality, paused, currentFrame, attributes: player.getAttributeNames().sort().join() };
  });
  const { own, attributes, ...values } = told;
  assert.deepEqual(own, []);
  assert.deepEqual(values, { exact: false, loop: true, controls: true, muted: true, volume: 0.25, playbackRate: 2, camera: "turned", overlay: "changes", range: [3, 9], quality: 0.5, paused: true, currentFrame: 5 });
  assert.equal(attributes, "aria-label,controls,exact,loop,quality,range,role,src,tabindex");
  await page.evaluate(() => (document.querySelector("decogs-player").src = "/data/degree1.dgs"));
  await until(page, "player.frames.count === 4 && player.info !== null");
  assert.match(await page.evaluate(() => document.querySelector("decogs-player").currentSrc), /^http.*\/data\/degree1\.dgs$/);
  assert.deepEqual(page.complaints, []);
  await page.context().close();
});

for (const [what, act] of [
  ["plays", (player) => void player.play()],
  ["seeks", (player) => (player.currentTime = 1)],
  ["looks elsewhere", (player) => player.nextCamera(1)],
]) {
  test(`the poster stays until somebody ${what}`, async () => {
    const page = await browser.own(element(`src="/data/long.dgs" poster="${POSTER}"`));
    await until(page, "player?.info && inside.stage.drawnAt.length > 0 && !inside.stage.pending");
    await page.waitForTimeout(100);
    assert.equal(await posterSeen(page), true);
    await page.evaluate(`(${act})(document.querySelector("decogs-player"))`);
    await until(page, "!player.shadowRoot.querySelector('.poster').checkVisibility()");
    await page.evaluate(() => document.querySelector("decogs-player").load());
    await ready(page);
    assert.equal(await posterSeen(page), true);
    await page.context().close();
  });
}

test("a poster with nothing behind it hides a subject, until somebody turns that", async () => {
  const page = await browser.own(element(`src="/data/subject.dgs" poster="${POSTER}"`));
  await until(page, "player?.info && inside.stage.drawnAt.length > 0 && !inside.stage.pending");
  const opacity = () => page.evaluate(() => getComputedStyle(document.querySelector("decogs-player").shadowRoot.querySelector("canvas")).opacity);
  assert.equal(await opacity(), "0");
  await page.mouse.move(100, 100);
  await page.mouse.down();
  await page.mouse.move(140, 100, { steps: 3 });
  await page.mouse.up();
  await until(page, "!player.shadowRoot.querySelector('.poster').checkVisibility()");
  assert.equal(await opacity(), "1");
  await page.context().close();
});

test("nothing of a stream is read before somebody plays it, where the page wants that", async () => {
  const asked = () => browser.server.requests.filter(({ path }) => path === "/data/long.dgs").length;
  const before = asked();
  const page = await browser.own(element('src="/data/long.dgs" preload="none"'));
  await until(page, "player?.shadowRoot?.querySelector('.start')?.checkVisibility()");
  await page.waitForTimeout(300);
  assert.equal(asked(), before);
  assert.deepEqual(await page.evaluate(() => { const { readyState, paused, preload, currentSrc } = document.querySelector("decogs-player"); return [readyState, paused, preload, currentSrc.endsWith("/data/long.dgs")]; }), [0, true, "none", true]);
  await page.locator(".start").click();
  await until(page, "player.currentTime > 0.2");
  assert.deepEqual(page.complaints, []);
  await page.context().close();
  const plays = await browser.own(element('src="/data/long.dgs" preload="none" autoplay'));
  await until(plays, "player?.currentTime > 0.1");
  await plays.context().close();
  const later = await browser.own(element('src="/data/long.dgs" preload="none"'));
  await until(later, "player?.shadowRoot?.querySelector('.start') != null");
  await later.evaluate(() => (document.querySelector("decogs-player").preload = "auto"));
  await ready(later);
  await later.context().close();
  const missing = await browser.own(element('src="/data/none.dgs" preload="none"'));
  await until(missing, "player?.play");
  for (const time of ["once", "again"]) {
    const refused = await missing.evaluate(() => document.querySelector("decogs-player").play().then(() => "plays", ({ name }) => name));
    assert.equal(refused, "NotSupportedError", time);
  }
  await missing.context().close();
});

test("of a stream whose first picture alone is wanted, no more is read", async () => {
  const requests = async (attributes) => {
    const { length } = browser.server.requests;
    const page = await browser.own(element(`src="/data/wide.dgs" ${attributes}`));
    await ready(page);
    await page.waitForTimeout(700);
    const read = await page.evaluate(() => { const { buffered } = document.querySelector("decogs-player"); return buffered.length > 0 ? buffered.end(0) : 0; });
    const count = browser.server.requests.slice(length).filter(({ path }) => path === "/data/wide.dgs").length;
    if (attributes !== "") {
      await page.evaluate(() => void document.querySelector("decogs-player").play());
      await until(page, `player.buffered.end(0) > ${read + 1}`);
    }
    await page.context().close();
    return [read, count];
  };
  const [all, many] = await requests("");
  const [little, few] = await requests('preload="metadata"');
  assert.ok(little < all / 2 && few < many, `${little} s of ${all}, ${few} requests instead of ${many}`);
});

test("cookies go to another server where the page says so", async () => {
  for (const [attribute, credentials] of [["", undefined], ["crossorigin", undefined], ['crossorigin="use-credentials"', "include"]]) {
    const page = await browser.own(`${element(`src="/data/long.dgs" ${attribute}`).replace(PLAYER, `<script>(${noting})()</script>${PLAYER}`)}`);
    await ready(page);
    assert.equal(await page.evaluate(() => globalThis.sent.find(({ type }) => type === "open").credentials), credentials);
    await page.context().close();
  }
});

test("callbacks of frames are called with each frame that comes into the picture, and not for the same from elsewhere", async () => {
  const page = await browser.own(element('src="/data/long.dgs"'));
  await ready(page);
  await until(page, "!inside.stage.pending");
  const told = await page.evaluate(async () => {
    const player = document.querySelector("decogs-player");
    const times = [];
    const note = (now, { mediaTime, width, height, presentedFrames }) => {
      times.push([mediaTime, player.info.frame, width, height, presentedFrames, now > 0]);
      player.requestVideoFrameCallback(note);
    };
    player.requestVideoFrameCallback(note);
    player.cancelVideoFrameCallback(player.requestVideoFrameCallback(() => times.push("taken back")));
    player.nextCamera(1);
    await new Promise((done) => setTimeout(done, 400));
    const before = times.length;
    await player.play();
    while (times.length < before + 5) await new Promise((done) => setTimeout(done, 20));
    player.pause();
    const told = times.slice(before);
    await new Promise((done) => setTimeout(done, 400));
    const same = times.length;
    player.currentFrame = player.info.frame;
    while (times.length === same) await new Promise((done) => setTimeout(done, 20));
    return [before, told];
  });
  assert.equal(told[0], 0);
  for (const [mediaTime, frame, width, height, , now] of told[1]) {
    assert.ok(Math.abs(mediaTime * 30 - frame) < 1e-6);
    assert.deepEqual([width, height, now], [180, 140, true]);
  }
  const counts = told[1].map((each) => each[4]);
  assert.ok(counts.every((count, at) => at === 0 || count === counts[at - 1] + 1), counts.join());
  await page.context().close();
});

const scroll = (page, to) => page.evaluate((to) => scrollTo(0, to), to);

test("a player that is scrolled away pauses and draws nothing, and goes on when it is seen again", async () => {
  const page = await browser.own(`${element('src="/data/long.dgs" loop orbit')}<div style="height: 3000px"></div>`);
  await ready(page);
  await page.evaluate(() => document.querySelector("decogs-player").play());
  await until(page, "player.currentTime > 0.1");
  await scroll(page, 2000);
  await until(page, "player.paused");
  await page.waitForTimeout(100);
  const [last, at] = [await drawn(page), await page.evaluate(() => document.querySelector("decogs-player").currentTime)];
  await page.evaluate(() => document.querySelector("decogs-player").nextCamera(1));
  await page.waitForTimeout(500);
  assert.deepEqual([await drawn(page), await page.evaluate(() => document.querySelector("decogs-player").currentTime)], [last, at]);
  assert.equal(await page.evaluate(() => document.querySelector("decogs-player")[Symbol.for("decogs.inside")].ticking), 0);
  await scroll(page, 0);
  await until(page, `!player.paused && player.currentTime !== ${at} && inside.stage.drawnAt.at(-1) > ${last}`);
  // Who paused it goes on being obeyed.
  await page.evaluate(() => document.querySelector("decogs-player").pause());
  await scroll(page, 2000);
  await page.waitForTimeout(200);
  await scroll(page, 0);
  await page.waitForTimeout(200);
  assert.equal(await page.evaluate(() => document.querySelector("decogs-player").paused), true);
  await page.context().close();
});

test("a player far down the page begins by itself when it comes into sight", async () => {
  const page = await browser.own(`<div style="height: 2000px"></div>${element('src="/data/long.dgs" autoplay loop')}`);
  await ready(page);
  await page.waitForTimeout(400);
  assert.deepEqual(await page.evaluate(() => { const { paused, currentTime } = document.querySelector("decogs-player"); return [paused, currentTime]; }), [true, 0]);
  await page.evaluate(() => document.querySelector("decogs-player").scrollIntoView());
  await until(page, "!player.paused && player.currentTime > 0.1");
  await page.context().close();
});

test("where the kernel draws, playing begins out of sight, too", async () => {
  const page = await browser.own(`<div style="height: 2000px"></div>${element('src="/data/long.dgs"').replace('exact="off"', "exact")}`);
  await ready(page);
  await page.evaluate(() => document.querySelector("decogs-player").play());
  await until(page, "player.currentTime > 0.1");
  await page.context().close();
});

test("a player that is heard plays on where it is not seen, without drawing, until it is muted", async () => {
  const page = await browser.own(`${element('src="/data/tones.dgs" loop controls')}<div style="height: 3000px"></div>`);
  await until(page, "player?.shadowRoot?.querySelector('.bar') != null && player.info !== null");
  await page.locator(".play").click();
  await until(page, "player.currentTime > 0.3");
  await scroll(page, 2000);
  await page.waitForTimeout(300);
  const [last, at] = [await drawn(page), await page.evaluate(() => document.querySelector("decogs-player").currentTime)];
  await until(page, `player.currentTime > ${at + 0.3}`);
  assert.equal(await page.evaluate(() => document.querySelector("decogs-player").paused), false);
  assert.equal(await drawn(page), last);
  await page.evaluate(() => (document.querySelector("decogs-player").muted = true));
  assert.equal(await page.evaluate(() => document.querySelector("decogs-player").paused), true);
  await scroll(page, 0);
  await until(page, "!player.paused");
  await page.context().close();
});

for (const exact of ["off", ""]) {
  test(`a worker that dies leaves no promise open, and another one plays on${exact === "" ? ", drawn exactly" : ""}`, async () => {
    const page = await browser.own(element(`src="/data/long.dgs"`).replace(PLAYER, `<script>(${noting})()</script>${PLAYER}`).replace('exact="off"', `exact="${exact}"`));
    await ready(page);
    await show(page, 7);
    await until(page, "!inside.stage.pending && !inside.stage.renderer.busy");
    const outcomes = await page.evaluate(async () => {
      const player = document.querySelector("decogs-player");
      const outcome = (promise) => Promise.race([promise.then(() => "resolved", (error) => error.message), new Promise((done) => setTimeout(() => done("pending"), 3000))]);
      const [worker] = globalThis.workers;
      worker.terminate();
      const asked = [player.ply(), player.thumbnail(0, 40), player.capture(1000, 700)].map(outcome);
      worker.dispatchEvent(new ErrorEvent("error", { message: "out of memory" }));
      const then = [player.ply(), player.thumbnail(0, 40)].map(outcome);
      player.lookThrough(1, true);
      const captured = outcome(player.capture(1000, 700));
      return Promise.all([...asked, ...then, captured]);
    });
    assert.deepEqual(outcomes.slice(0, 2), ["out of memory", "out of memory"]);
    assert.deepEqual(outcomes.slice(3), ["out of memory", "out of memory", "out of memory"]);
    assert.notEqual(outcomes[2], "pending");
    await until(page, "player.error === 'out of memory' && inside.ticking === 0");
    await page.evaluate(() => document.querySelector("decogs-player").play());
    await until(page, "player.error === null && player.info?.frame > 8");
    await page.context().close();
  });
}

test("on a phone the bar is a row at the bottom, which goes while the stream plays", async () => {
  for (const [width, height, most] of [[390, 844, 0.07], [320, 568, 0.1], [740, 360, 0.16]]) {
    const context = { hasTouch: true, isMobile: true, width, height };
    const page = await browser.own(`<meta name="viewport" content="width=device-width">${element('src="/data/tones.dgs" controls loop autoplay style="height: 100vh; aspect-ratio: auto"')}`, context);
    await until(page, "player?.shadowRoot?.querySelector('.bar') != null && player.info !== null");
    await page.evaluate(() => document.querySelector("decogs-player").pause());
    await until(page, `player.shadowRoot.querySelector(".menu").contains(player.shadowRoot.querySelector(".cameras")) === ${width <= 520}`);
    const told = await page.evaluate(() => {
      const root = document.querySelector("decogs-player").shadowRoot;
      const box = (selector) => root.querySelector(selector).getBoundingClientRect();
      return { bar: box(".bar").top, track: box(".timeline").width };
    });
    assert.ok((height - told.bar) / height < most, `${width}: ${height - told.bar} of ${height}`);
    assert.ok(told.track > 70, `${told.track}`);
    await page.locator(".play").tap();
    await until(page, "getComputedStyle(player.shadowRoot.querySelector('.bar')).opacity === '0'");
    assert.deepEqual(page.complaints, []);
    await page.context().close();
  }
});
