/** What keys do. The help panel is made from the same table, so that it cannot say anything else. */
import type { PlayerApi } from "../player_api";
import type { Vector } from "../geometry/vectors";

/** What keys may ask of the panels. */
export interface KeyPanels {
  mark(): void;
  toggleStatistics(): void;
  toggleHelp(): void;
  toggleFullScreen(): Promise<void>;
  savePicture(): Promise<void>;
  /** Whether anything was open. */
  closeAll(): boolean;
  /** Whether the player filled the window. */
  leaveFullWindow(): boolean;
}

interface KeyAction {
  readonly keys: readonly string[];
  readonly shown: string;
  readonly text: string;
  /** false: there was nothing to do, and the key is for others. */
  readonly act: (player: PlayerApi, panels: KeyPanels, event: KeyboardEvent) => unknown;
}

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];

export const KEY_ACTIONS: readonly KeyAction[] = [
  {
    keys: [" ", "k"],
    shown: "Space",
    text: "play or pause",
    act: (player) => {
      playOrPause(player);
    },
  },
  {
    keys: ["ArrowLeft", "ArrowRight", ",", "."],
    shown: "← → , .",
    text: "a frame back or on; with Shift to a keyframe",
    act: (player, _, { key, shiftKey }) => {
      stepFrame(player, key === "ArrowLeft" || key === "," ? -1 : 1, shiftKey);
    },
  },
  {
    keys: ["Home", "End"],
    shown: "Home End",
    text: "first or last frame",
    act: (player, _, { key }) => {
      player.currentFrame = key === "Home" ? 0 : player.frames.count - 1;
    },
  },
  {
    keys: Array.from("0123456789"),
    shown: "0 to 9",
    text: "to that tenth of the time",
    act: (player, _, { key }) => {
      player.currentTime = (player.duration * Number(key)) / 10;
    },
  },
  {
    keys: ["[", "]"],
    shown: "[ ]",
    text: "camera before or after",
    act: (player, _, { key }) => {
      player.nextCamera(key === "[" ? -1 : 1);
    },
  },
  { keys: ["m"], shown: "M", text: "sound on or off", act: (player) => { player.muted = !player.muted; } },
  { keys: ["r"], shown: "R", text: "back to the camera", act: (player) => { player.backToCamera(); } },
  {
    keys: ["-", "+", "="],
    shown: "− +",
    text: "slower or faster",
    act: (player, _, { key }) => {
      const at = SPEEDS.findIndex((speed) => speed >= player.playbackRate);
      player.playbackRate = SPEEDS[Math.max(0, Math.min(SPEEDS.length - 1, at + (key === "-" ? -1 : 1)))]!;
    },
  },
  { keys: ["l"], shown: "L", text: "loop", act: (player) => { player.loop = !player.loop; } },
  { keys: ["x"], shown: "X", text: "mark where a loop begins, where it ends, and end it", act: (_, panels) => { panels.mark(); } },
  {
    keys: ["c"],
    shown: "C",
    text: "what changes: off, glow, still against moving",
    act: (player) => {
      player.overlay = player.overlay === "none" ? "changes" : player.overlay === "changes" ? "motion" : "none";
    },
  },
  { keys: ["o"], shown: "O", text: "as the camera recorded it", act: (player) => { player.recorded = !player.recorded; } },
  { keys: ["b"], shown: "B", text: "the recorded picture beside it, where it is known", act: (player) => { player.comparing = !player.comparing; } },
  { keys: ["i"], shown: "I", text: "figures", act: (_, panels) => { panels.toggleStatistics(); } },
  { keys: ["p"], shown: "P", text: "save the picture", act: (_, panels) => { void panels.savePicture(); } },
  { keys: ["f"], shown: "F", text: "full screen", act: (_, panels) => { void panels.toggleFullScreen(); } },
  { keys: ["?", "h"], shown: "?", text: "this help", act: (_, panels) => { panels.toggleHelp(); } },
  { keys: ["Escape"], shown: "Esc", text: "close", act: (_, panels) => panels.closeAll() || panels.leaveFullWindow() },
];

/** Directions of flight by the key's place, so that they lie together on every keyboard. */
const FLIGHT: ReadonlyMap<string, Vector> = new Map<string, Vector>([
  ["KeyW", [0, 0, 1]],
  ["KeyS", [0, 0, -1]],
  ["KeyA", [-1, 0, 0]],
  ["KeyD", [1, 0, 0]],
  ["KeyE", [0, 1, 0]],
  ["KeyQ", [0, -1, 0]],
]);

const held = new WeakMap<PlayerApi, Set<string>>();

/** Does what a key asks for; whether it asked for anything. */
export function looksInto(player: PlayerApi, panels: KeyPanels, event: KeyboardEvent): boolean {
  if (event.ctrlKey || event.metaKey || event.altKey) return false;
  if (FLIGHT.has(event.code)) return fly(player, event);
  if (event.type !== "keydown" || (inField(event) && event.key !== "Escape")) return false;
  const action = KEY_ACTIONS.find(({ keys }) => keys.includes(event.key) || keys.includes(event.key.toLowerCase()));
  if (action === undefined) return false;
  return action.act(player, panels, event) !== false;
}

/** What goes wrong is in the notice. */
export function playOrPause(player: PlayerApi): void {
  if (player.paused) player.play().catch(() => undefined);
  else player.pause();
}

function fly(player: PlayerApi, event: KeyboardEvent): boolean {
  const keys = held.get(player) ?? new Set<string>();
  held.set(player, keys);
  if (event.type === "keydown" && !inField(event)) keys.add(event.code);
  else keys.delete(event.code);
  const sum: [number, number, number] = [0, 0, 0];
  const speed = event.shiftKey ? 3 : 1;
  for (const key of keys) for (const axis of [0, 1, 2] as const) sum[axis] += speed * FLIGHT.get(key)![axis];
  player.fly(sum);
  return true;
}

/** Forgets keys whose release another window has seen. */
export function forgetKeys(player: PlayerApi): void {
  held.delete(player);
}

function stepFrame(player: PlayerApi, direction: -1 | 1, toKeyframe: boolean): void {
  player.pause();
  const at = player.currentFrame;
  player.currentFrame = toKeyframe ? player.frames.keyframe(at, direction) : at + direction;
}

/** Whether the key belongs to a control that knows what to do with it. */
function inField(event: KeyboardEvent): boolean {
  const target = event.composedPath()[0];
  if (target instanceof HTMLSelectElement) return true;
  return target instanceof HTMLButtonElement && (event.key === " " || event.key === "Enter");
}
