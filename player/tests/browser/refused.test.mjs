// Where the browser, or the page's server, refuses what the player would use: policies, sandboxed frames, a kernel that is not there.
import assert from "node:assert/strict";
import { readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { after, afterEach, before, test } from "node:test";
import { picture, psnr, ready, show, started, until } from "./harness.mjs";

let browser;
before(async () => (browser = await started()));
afterEach(() => (browser.server.options.headers = {}));
after(() => browser.close());

const [, POLICY] = /^```\n(default-src .*)\n```$/m.exec(readFileSync(new URL("../../../docs/see-it.md", import.meta.url), "utf8"));
const INDEX = readFileSync(join(process.env.DECOGS_PAGE, "index.html"), "utf8").replace("scene.dgs", "/data/long.dgs");
const OWN = '<!doctype html><script type="module" src="decogs-player.js"></script><decogs-player controls src="/data/long.dgs"></decogs-player>';
/** A policy forbids the harness's expressions, too. */
const plays = (page) => page.waitForFunction(() => document.querySelector("decogs-player").figures?.pictures > 0 && document.querySelector("decogs-player").shadowRoot.querySelector(".bar"));
const failed = (page) => page.waitForFunction(() => document.querySelector("decogs-player").error);
const refusal = (page) =>
  page.evaluate(async () => {
    const player = document.querySelector("decogs-player");
    const outcome = await player.play().then(() => "plays", (error) => [error.name, error.message]);
    return { outcome, error: player.error };
  });
/** The policy for every answer: a worker has that of its own script. */
const underPolicy = (policy) => (browser.server.options.headers = { "content-security-policy": policy });

for (const [whose, html] of [["the folder's page", INDEX], ["a page of one's own", OWN]]) {
  test(`under the policy that is documented, ${whose} has its size, its controls and a picture`, async () => {
    underPolicy(POLICY);
    const page = await browser.own(html, { headers: browser.server.options.headers });
    await plays(page);
    const [ratio, inside, radius] = await page.evaluate(async () => {
      const player = document.querySelector("decogs-player");
      await player.play();
      const bar = player.shadowRoot.querySelector(".bar");
      const [outer, inner] = [player.getBoundingClientRect(), bar.getBoundingClientRect()];
      return [outer.width / outer.height, inner.top > outer.top && inner.bottom < outer.bottom, getComputedStyle(bar).borderRadius];
    });
    await page.waitForFunction(() => document.querySelector("decogs-player").info.frame > 0);
    assert.ok(Math.abs(ratio - (html === INDEX ? 4 / 3 : 16 / 9)) < 0.02, `${ratio}`);
    assert.deepEqual([inside, radius], [true, "12px"]);
    assert.deepEqual(page.complaints, []);
    await page.context().close();
  });
}

for (const [what, part, reason] of [
  ["workers", /worker-src [^;]*;/, /worker-src/],
  ["WebAssembly", / 'wasm-unsafe-eval'/, /WebAssembly/],
]) {
  test(`a policy that forbids ${what} is named, and play() is refused`, async () => {
    const stricter = POLICY.replace(part, "").replace("script-src", `${what === "workers" ? "worker-src 'none'; " : ""}script-src`);
    underPolicy(stricter);
    const page = await browser.own(OWN, { headers: browser.server.options.headers });
    await failed(page);
    const { outcome, error } = await refusal(page);
    assert.match(outcome[1], reason);
    assert.equal(outcome[0], "NotSupportedError");
    assert.equal(error, outcome[1]);
    await page.context().close();
  });
}

const SANDBOXED = (address) => `<!doctype html><iframe sandbox="allow-scripts" src="${address}" width="360" height="240"></iframe>`;

for (const [whose, address] of [["the folder's page", "index.html?src=/data/long.dgs"], ["a page of one's own", "framed.html"]]) {
  test(`in a sandboxed frame ${whose} plays`, async () => {
    browser.server.options.headers = { "access-control-allow-origin": "*" };
    writeFileSync(join(process.env.DECOGS_PAGE, "framed.html"), OWN);
    writeFileSync(join(process.env.DECOGS_PAGE, "around.html"), SANDBOXED(address));
    const page = await browser.browser.newPage();
    const complaints = [];
    page.on("console", (message) => message.type() === "error" && complaints.push(message.text()));
    await page.goto(`${browser.server.address}/page/around.html`);
    const frame = page.frames()[1];
    await plays(frame);
    assert.deepEqual(await frame.evaluate(() => [globalThis.origin, document.querySelector("decogs-player").error]), ["null", null]);
    assert.deepEqual(complaints.filter((text) => !text.includes("404")), []); // the icon of the page around it
    await page.close();
  });
}

test("in a sandboxed frame whose server lets nobody in, the page names the frame, not the disk", async () => {
  const page = await browser.own(SANDBOXED("index.html"));
  await page.frameLocator("iframe").locator("text=sandbox").waitFor({ state: "visible" });
  assert.equal(await page.frameLocator("iframe").locator("text=http.server").isVisible(), false);
  await page.context().close();
});

test("what is no address is an error, until another one is set", async () => {
  const page = await browser.own('<script type="module" src="decogs-player.js"></script><decogs-player exact="off" src="http://:none"></decogs-player>');
  await until(page, "player?.error != null");
  assert.deepEqual(await refusal(page), { outcome: ["NotSupportedError", "http://:none is no address"], error: "http://:none is no address" });
  await page.evaluate(() => (document.querySelector("decogs-player").src = "/data/long.dgs"));
  await ready(page);
  assert.deepEqual(await refusal(page), { outcome: "plays", error: null });
  assert.deepEqual(page.complaints, []);
  await page.context().close();
});

/** The page as it is where WebGL2 is software, without the kernel. */
async function withoutKernel({ webgl }) {
  const context = await browser.browser.newContext({ viewport: { width: 200, height: 150 } });
  const page = await context.newPage();
  await page.route("**/decogs-exact.wasm", (route) => route.fulfill({ status: 404 }));
  if (!webgl) {
    await page.addInitScript(() => {
      const given = HTMLCanvasElement.prototype.getContext;
      HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
        return kind.startsWith("webgl") ? null : given.call(this, kind, ...more);
      };
    });
  }
  await page.goto(`${browser.server.address}/page/index.html?src=/data/long.dgs`);
  return page;
}

test("without the kernel WebGL2 draws, and a notice says why", async () => {
  const page = await withoutKernel({ webgl: true });
  await until(page, "player.figures?.pictures > 0 && !player.exact && player.shadowRoot.querySelector('.bar')");
  await until(page, "player.shadowRoot.textContent.includes('WebGL2 draws: the exact picture is not to be had')");
  const drawn = await picture(page, 200, 150);
  const other = await browser.opened("long"); // by WebGL2, as it was asked for
  await ready(other);
  assert.ok(psnr(drawn, await picture(other, 200, 150)) > 60);
  assert.deepEqual(await refusal(page), { outcome: "plays", error: null });
  await page.evaluate(() => document.querySelector("decogs-player").pause());
  await show(page, 0);
  // Asked for by name, it is tried again.
  await page.unroute("**/decogs-exact.wasm");
  await page.evaluate(() => (document.querySelector("decogs-player").exact = true));
  await until(page, "player.exact && !player.shadowRoot.textContent.includes('WebGL2 draws')");
  assert.ok(psnr(await picture(page, 200, 150), drawn) > 30);
  await page.context().close();
  await other.context().close();
});

test("a picture that the kernel cannot draw is refused where the kernel was chosen, and it goes on", async () => {
  const page = await browser.opened("arc", { query: "&exact" });
  await until(page, "player.figures?.pictures > 0 && player.exact");
  const refused = await page.evaluate(() => document.querySelector("decogs-player").capture(8000, 4500).then(() => "", String));
  assert.match(refused, /8000x4500 cannot be drawn exactly/);
  assert.equal((await picture(page, 64, 48)).width, 64);
  assert.deepEqual(await page.evaluate(() => [document.querySelector("decogs-player").exact, document.querySelector("decogs-player").error]), [true, null]);
  await page.context().close();
});

test("without the kernel and without WebGL2 the player says what is wrong, and play() is refused", async () => {
  const page = await withoutKernel({ webgl: false });
  const early = await page.evaluate(() => document.querySelector("decogs-player").play().then(() => "plays", ({ name }) => name));
  assert.equal(early, "NotSupportedError");
  const { outcome, error } = await refusal(page);
  assert.deepEqual(outcome, ["NotSupportedError", error]);
  assert.match(error, /decogs-exact\.wasm: HTTP 404/);
  await page.unroute("**/decogs-exact.wasm");
  assert.deepEqual(await refusal(page), { outcome: "plays", error: null });
  await until(page, "player.figures.pictures > 0 && player.exact");
  await page.context().close();
});
