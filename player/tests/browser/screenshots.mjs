// Pictures to be looked at: the player on large and small screens, in an article, in scenes of engines and in a headset:
//   node tests/browser/screenshots.mjs PAGE STREAM.dgs FOLDER
import { cpSync, mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { basename, dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";
import { chromiumPath, launched } from "./chromium.mjs";
import { served } from "./server.mjs";

const [page, stream, folder] = process.argv.slice(2);
if (chromiumPath === undefined) {
  console.error("Chromium is not installed (DECOGS_CHROMIUM names another place)");
  process.exit(77);
}
const here = dirname(fileURLToPath(import.meta.url));
const IWER = createRequire(import.meta.url).resolve("iwer").replace(/\/lib\/.*$/, "/build/iwer.min.js");
const NAME = basename(stream);
const WORDS = "<p>An article goes on before and after its moving picture, and is read with a thumb: the page scrolls where the picture is touched, too.</p>";
/** Width, height, whether it is a phone; and what is clicked before the picture is taken. */
const SCREENS = {
  desktop: [1280, 720, false],
  "desktop-menu": [1280, 720, false, "[name=menu]"],
  "desktop-help": [1280, 720, false, "[name=menu]", "[name=help]"],
  "phone-320": [320, 568, true],
  "phone-320-menu": [320, 568, true, "[name=menu]"],
  "phone-390": [390, 844, true],
  "phone-390-menu": [390, 844, true, "[name=menu]"],
  "phone-landscape": [740, 360, true],
  "phone-landscape-menu": [740, 360, true, "[name=menu]"],
};

mkdirSync(folder, { recursive: true });
const scripts = mkdtempSync(join(tmpdir(), "decogs-screenshots-"));
cpSync(page, scripts, { recursive: true });
await build({ entryPoints: [join(here, "screenshots_page.mjs")], outfile: join(scripts, "scenes.js"), bundle: true, format: "esm", logLevel: "error" });
const article = (title, player) => `<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<style>body { font: 16px/1.5 Georgia, serif; max-width: 34em; margin: 1em auto; padding: 0 1em }</style>
<script type="module" src="/page/decogs-player.js"></script><h1>${title}</h1>${WORDS}${player}${WORDS}</html>`;
const player = `<decogs-player src="/data/${NAME}" controls gestures="cooperative"></decogs-player>`;
const frame = `<iframe src="/page/index.html?src=/data/${NAME}" title="Free-viewpoint video" style="border: 0; width: 100%; aspect-ratio: 16 / 9"></iframe>`;
writeFileSync(join(scripts, "element.html"), article("The element in an article", player));
writeFileSync(join(scripts, "frame.html"), article("The page in a frame of an article", frame));

const server = await served({ page: scripts, data: dirname(resolve(stream)) });
const browser = await launched();

async function opened(path, width, height, phone, script = "") {
  const context = await browser.newContext({ viewport: { width, height }, hasTouch: phone, isMobile: phone, deviceScaleFactor: phone ? 2 : 1 });
  const tab = await context.newPage();
  tab.on("pageerror", (error) => console.error(path, String(error)));
  await tab.addInitScript({ content: script });
  await tab.goto(`${server.address}${path}`);
  return tab;
}

/** When the picture is whole and the controls are there. */
async function rested(frame) {
  await frame.waitForFunction(() => {
    const player = document.querySelector("decogs-player");
    const inside = player?.[Symbol.for("decogs.inside")];
    return player?.info && player.shadowRoot.querySelector(".bar") !== null && !inside.stage.pending && !inside.stage.renderer.busy;
  }, null, { timeout: 60_000 });
}

async function taken(tab, name) {
  await tab.screenshot({ path: join(folder, `${name}.png`) });
  await tab.context().close();
  console.log(name);
}

try {
  for (const [name, [width, height, phone, ...clicked]] of Object.entries(SCREENS)) {
    const tab = await opened(`/page/index.html?src=/data/${NAME}`, width, height, phone);
    await rested(tab);
    for (const selector of clicked) await tab.locator(selector).click();
    await rested(tab);
    await taken(tab, name);
  }
  for (const [name, path, width, height, phone] of [["article-element", "element", 800, 900, false], ["article-frame", "frame", 800, 900, false], ["article-phone", "element", 390, 844, true]]) {
    const tab = await opened(`/page/${path}.html`, width, height, phone);
    await rested(path === "frame" ? tab.frames()[1] : tab);
    await taken(tab, name);
  }
  for (const name of ["three", "playcanvas"]) {
    const tab = await opened("/page/index.html?src=/data/none.dgs", 960, 540, false);
    await tab.evaluate(() => document.body.replaceChildren());
    await tab.addScriptTag({ type: "module", url: "/page/scenes.js" });
    await tab.waitForFunction(() => globalThis.scenes !== undefined);
    await tab.evaluate(([name, address]) => globalThis.scenes[name](address), [name, `/data/${NAME}`]);
    await taken(tab, `scene-${name}`);
  }
  const begin = () => {
    const { XRDevice, metaQuest3 } = globalThis.IWER;
    new XRDevice(metaQuest3, { stereoEnabled: true }).installRuntime({ forceInstall: true });
  };
  const tab = await opened(`/page/index.html?src=/data/${NAME}`, 1280, 720, false, `${readFileSync(IWER, "utf8")}\n(${begin})();`);
  await rested(tab);
  await tab.evaluate(() => document.querySelector("decogs-player").enterXr("immersive-vr"));
  await tab.waitForTimeout(8000);
  await taken(tab, "headset");
} finally {
  await browser.close();
  await server.close();
  rmSync(scripts, { recursive: true, force: true });
}
