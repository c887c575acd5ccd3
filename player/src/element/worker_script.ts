/** The worker's script. It lies beside this one; the package has its text instead, in place of this file (build.mjs). */
const { href, origin } = new URL("./decogs-worker.js", import.meta.url);

/** null where the page may start no worker from there: the script is of another origin. A sandboxed frame has none. */
export const address = origin === globalThis.origin ? href : null;

/** A script that becomes the worker; no module, which browsers take from no text in a sandboxed frame. It keeps what comes before that. */
export const text = `
const early = [];
onmessage = (event) => early.push(event);
import(${JSON.stringify(href)}).then(
  () => early.forEach((event) => onmessage(event)),
  (error) => setTimeout(() => { throw error; }),
);`;
