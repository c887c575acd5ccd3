/** What the controls are made of. Names of the stream are never written into it: those go in as text. */
import { icon } from "./icons";
import { KEY_ACTIONS } from "./keys";

const option = (value: string, text: string): string => `<option value="${value}">${text}</option>`;

const GESTURES: readonly (readonly [string, string])[] = [
  ["Drag", "circle the scene"],
  ["Right drag, Shift drag", "shift; with two fingers, too"],
  ["Wheel, pinch", "nearer or farther"],
  ["Ctrl drag", "look around"],
  ["W A S D  Q E", "fly; faster with Shift"],
];

function helpRows(): string {
  const keys = KEY_ACTIONS.map(({ shown, text }) => [shown, text] as const);
  return [...GESTURES, ...keys].map(([key, text]) => `<dt>${key}</dt><dd>${text}</dd>`).join("");
}

export function markup(): string {
  return `
<div class="recording" hidden><div class="divider" role="slider" tabindex="0" aria-label="Recorded picture against the scene" aria-valuemin="0" aria-valuemax="100"></div></div>
<div class="veil" part="loading" hidden><span class="spinner"></span><span class="percent"></span></div>
<button class="start" type="button" aria-label="Play" hidden>${icon("play")}</button>
<dl class="figures panel" aria-label="Figures" hidden></dl>
<div class="legend panel" hidden></div>
<div class="notice panel" role="status" aria-live="polite" hidden></div>
<section class="help panel" role="dialog" aria-label="Help" hidden>
  <header><h2>Moving about</h2><button class="shut" type="button" aria-label="Close help">${icon("close")}</button></header>
  <dl>${helpRows()}</dl>
</section>
<div class="menu panel" role="group" aria-label="View" hidden>
  <label>Show <select name="overlay">${option("none", "the scene")}${option("changes", "what changes now")}${option("motion", "still and moving")}</select></label>
  <label>Speed <select name="rate">${[0.1, 0.25, 0.5, 1, 2, 4].map((rate) => option(String(rate), `${rate} ×`)).join("")}</select></label>
  <label title="Fewer pixels and fewer Gaussians, for weak devices">Quality <select name="quality">${option("1", "whole")}${option("0.5", "a half")}${option("0.25", "a quarter")}</select></label>
  <label class="check"><input type="checkbox" name="loop"> Loop</label>
  <label class="check" title="Drawn by the decoder's own renderer, to the bit; slower"><input type="checkbox" name="exact"> Exact picture</label>
  <label class="check" title="Cameras of the rig with their lens, their colours, and where they stood in the frame"><input type="checkbox" name="recorded"> As recorded</label>
  <label class="check" title="What the camera recorded, left of a line that can be dragged"><input type="checkbox" name="comparing"> Recorded picture beside it</label>
  <label class="check"><input type="checkbox" name="figures"> Figures</label>
  <hr>
  <button type="button" name="picture">Save picture</button>
  <button type="button" name="ply" title="The frame's Gaussians, for other viewers">Save frame as .ply</button>
  <button type="button" name="crop" title="Draw what is to stay, for decogs-edit">Crop with decogs-edit</button>
  <button type="button" name="pose">Copy camera as pose.json</button>
  <button type="button" name="link">Copy link to this view</button>
  <button type="button" name="embed">Copy code to embed it</button>
  <button type="button" name="vr" hidden>Enter VR</button>
  <button type="button" name="ar" hidden>Enter AR</button>
  <button type="button" name="help">Help</button>
</div>
<div class="bar panel" part="controls">
  <div class="timeline" role="slider" tabindex="0" aria-label="Time" aria-valuemin="0" aria-valuemax="0" aria-valuenow="0"></div>
  <div class="row">
    <button class="play" type="button" aria-label="Play">${icon("play")}</button>
    <span class="time" aria-hidden="true"><span class="now-at"></span><span class="of"></span></span>
    <span class="space"></span>
    <span class="sound" role="group" aria-label="Sound" hidden></span>
    <span class="cameras" role="group" aria-label="Camera">
      <button type="button" name="previous" aria-label="Camera before">${icon("previous")}</button>
      <select name="camera" aria-label="Camera"></select>
      <button type="button" name="next" aria-label="Camera after">${icon("next")}</button>
    </span>
    <button type="button" name="menu" aria-label="View and tools" aria-expanded="false">${icon("menu")}</button>
    <button type="button" name="full" aria-label="Full screen">${icon("full")}</button>
  </div>
</div>`;
}
