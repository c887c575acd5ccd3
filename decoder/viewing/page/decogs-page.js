import { cameraFromLink } from "./decogs-player.js";

// The page's address says what to play: ?src=scene.dgs&follow#camera=...&frame=12
const player = document.querySelector("decogs-player");
const asked = new URLSearchParams(location.search);
for (const name of ["follow", "autoplay", "loop", "range", "quality", "camera", "poster", "exact", "recorded", "background", "orbit", "limits", "fence", "gestures"]) {
  if (asked.has(name)) player.setAttribute(name, asked.get(name));
}
// What is behind a subject beside colours: squares, or the page around this one's frame.
const squares = "repeating-conic-gradient(#999 0 25%, #666 0 50%) 0 0 / 24px 24px";
const behind = { checkerboard: squares, transparent: "none" }[asked.get("background")];
if (behind) document.documentElement.style.background = document.body.style.background = behind;
const lookAt = () => {
  const place = new URLSearchParams(location.hash.slice(1));
  const camera = cameraFromLink(place.get("camera") ?? "");
  if (camera !== null) player.lookFrom(camera.pose, camera.lens);
  const frame = Number(place.get("frame") ?? NaN);
  if (Number.isInteger(frame)) player.currentFrame = frame;
};
lookAt();
addEventListener("hashchange", lookAt);
player.src = asked.get("src") ?? player.dataset.src ?? "scene.dgs";
const titled = () => { document.title = `${player.header?.presentation.title || player.src.split("/").pop()} - decogs`; };
titled();
player.addEventListener("loadedmetadata", titled);
player.focus();
