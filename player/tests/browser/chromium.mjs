// Starts the Chromium that is installed, without a window and with WebGL2 in software, or without any.
import { existsSync } from "node:fs";
import { chromium } from "playwright-core";

const PLACES = [process.env.DECOGS_CHROMIUM, "/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];

/** The browser's path; undefined where there is none. */
export const chromiumPath = PLACES.find((path) => path && existsSync(path));

export function launched(webgl = true) {
  return chromium.launch({
    executablePath: chromiumPath,
    args: [
      "--headless",
      "--no-sandbox",
      ...(webgl ? ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"] : ["--disable-gpu", "--disable-software-rasterizer"]),
      "--disable-quic",
      "--no-first-run",
      "--disable-background-networking",
      "--disable-component-update",
      "--disable-sync",
      "--js-flags=--expose-gc",
    ],
  });
}
