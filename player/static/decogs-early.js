// Before the player's script has come, its worker begins with the stream; the player takes over what it has said by then.
{
  const { classList } = document.documentElement;
  const served = location.protocol !== "file:";
  classList.toggle("no-server", !served);
  // In a frame whose sandbox leaves it no origin, the browser starts no worker from an address; the player does it by other means.
  const owned = origin === location.origin;
  classList.toggle("no-origin", served && !owned);
  if (globalThis.Worker && served && owned) {
    const asked = new URLSearchParams(location.search);
    const player = document.querySelector("decogs-player");
    const source = new URL(asked.get("src") ?? player.dataset.src ?? "scene.dgs", document.baseURI).href;
    const follow = asked.has("follow") || player.hasAttribute("follow");
    const frame = Number(new URLSearchParams(location.hash.slice(1)).get("frame") ?? NaN);
    const first = Number.isInteger(frame) ? Math.max(0, frame) : 0;
    const own = globalThis.trustedTypes?.createPolicy("decogs-page", { createScriptURL: (address) => address });
    const script = "./decogs-worker.js";
    const worker = new Worker(own?.createScriptURL(script) ?? script, { type: "module" });
    const early = { worker, source, follow, first, messages: [], failed: false };
    worker.onmessage = ({ data }) => early.messages.push(data);
    worker.onerror = () => { early.failed = true; };
    worker.postMessage({ type: "open", source, follow, first });
    globalThis.decogsEarly = early;
  }
}
