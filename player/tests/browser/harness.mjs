// What the browser tests share: a server, a browser, a page with a player, and pictures as bytes.
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { launched } from "./chromium.mjs";
import { served } from "./server.mjs";

export const DATA = process.env.DECOGS_BROWSER_DATA;
export const listed = () => JSON.parse(readFileSync(join(DATA, "list.json"), "utf8"));

/** Has the element in a page of one's own. */
export const PLAYER = '<script type="module" src="decogs-player.js"></script>';

export async function started(folders = {}) {
  const server = await served({ page: process.env.DECOGS_PAGE, data: DATA, ...folders });
  const browser = await launched();
  return {
    server,
    browser,
    /** A page whose player is that large, draws by WebGL2 unless the query or `automatic` says otherwise, and plays a stream; what the page complains of is in `page.complaints`. */
    async opened(stream, { width = 200, height = 150, query = "", automatic = false, scale = 1, folder = "data", touch = false } = {}) {
      const context = await browser.newContext({ viewport: { width, height }, deviceScaleFactor: scale, hasTouch: touch, isMobile: touch });
      const page = await context.newPage();
      page.complaints = [];
      page.on("console", (message) => {
        if (message.type() === "error") page.complaints.push(message.text());
      });
      page.on("pageerror", (error) => page.complaints.push(String(error)));
      // Chromium draws in software here, where the kernel would draw by itself.
      const webgl = automatic || query.includes("&exact") ? "" : "&exact=off";
      await page.goto(`${server.address}/page/index.html?src=/${folder}/${stream}.dgs${webgl}${query}`);
      return page;
    },
    /** A page of one's own at an address of the player's, with headers; scripts, style sheets and stream are the page's. */
    async own(html, { headers = {}, width = 400, height = 300, ...more } = {}) {
      const context = await browser.newContext({ viewport: { width, height }, ...more });
      const page = await context.newPage();
      page.complaints = [];
      page.on("console", (message) => message.type() === "error" && page.complaints.push(message.text()));
      page.on("pageerror", (error) => page.complaints.push(String(error)));
      await page.route("**/page/own.html", (route) => route.fulfill({ contentType: "text/html", headers, body: html }));
      await page.goto(`${server.address}/page/own.html`);
      return page;
    },
    async close() {
      await browser.close();
      await server.close();
    },
  };
}

/** Waits until something holds of the player: an expression in `player`, and in what is `inside` it (element/player.ts). */
export function until(page, condition, timeout = 30_000) {
  return page.waitForFunction(
    (text) => {
      const player = document.querySelector("decogs-player");
      return new Function("player", "inside", `return ${text}`)(player, player?.[Symbol.for("decogs.inside")]);
    },
    condition,
    { timeout, polling: 50 },
  );
}

export const ready = (page) => until(page, "player.info !== null");

/** Shows a frame. */
export async function show(page, frame) {
  await page.evaluate((frame) => {
    document.querySelector("decogs-player").currentFrame = frame;
  }, frame);
  await until(page, `player.info?.frame === ${frame}`);
}

/** The player's picture of so many pixels: red, green, blue and alpha of each. */
export async function picture(page, width, height) {
  const text = await page.evaluate(
    async ([width, height]) => {
      const blob = await document.querySelector("decogs-player").capture(width, height);
      return new Promise((done) => {
        const reader = new FileReader();
        reader.onload = () => done(reader.result);
        reader.readAsDataURL(blob);
      });
    },
    [width, height],
  );
  return pixelsOf(page, text);
}

export async function filed(page, name) {
  const data = readFileSync(join(DATA, name)).toString("base64");
  return pixelsOf(page, `data:image/png;base64,${data}`);
}

/** A PNG's pixels, decoded by the browser. */
export async function pixelsOf(page, address) {
  const { width, height, base64 } = await page.evaluate(async (address) => {
    const image = new Image();
    image.src = address;
    await image.decode();
    const canvas = new OffscreenCanvas(image.width, image.height);
    const context = canvas.getContext("2d");
    context.drawImage(image, 0, 0);
    const { data } = context.getImageData(0, 0, image.width, image.height);
    let text = "";
    for (let at = 0; at < data.length; at += 8192) text += String.fromCharCode(...data.subarray(at, at + 8192));
    return { width: image.width, height: image.height, base64: btoa(text) };
  }, address);
  return { width, height, data: Buffer.from(base64, "base64") };
}

/** Peak signal to noise, in dB, of two pictures of one size, over a grey of this level where they are transparent. */
export function psnr(one, other, grey = 0) {
  if (one.width !== other.width || one.height !== other.height) {
    throw new Error(`pictures of ${one.width}x${one.height} and ${other.width}x${other.height}`);
  }
  const over = ({ data }, at) => grey + ((data[at] - grey) * data[at | 3]) / 255;
  let sum = 0;
  for (let at = 0; at < one.data.length; at++) if (at % 4 !== 3) sum += (over(one, at) - over(other, at)) ** 2;
  return 10 * Math.log10((255 ** 2 * one.width * one.height * 3) / sum);
}
