/**
 * What controls may ask of the player; they know nothing else of it. The element has all of it, and pages may use it too
 * (docs/see-it.md).
 */
import type { Vector } from "./geometry/vectors";
import type { Lens, PinholeCamera } from "./geometry/camera";
import type { Pose } from "./geometry/poses";
import type { FrameInfo } from "./messages";
import type { FrameKind, StreamHeader } from "./scene";

/** What of the stream's knowledge is painted over the scene. */
export const OVERLAYS = ["none", "changes", "motion"] as const;
export type Overlay = (typeof OVERLAYS)[number];

/** What is known of every frame, as columns. */
export interface FrameList {
  readonly count: number;
  /** Places in `FRAME_KINDS`; longer than there are frames. */
  readonly kinds: Uint8Array;
  readonly bytes: Uint32Array;
  readonly psnr: ReadonlyMap<number, number>;
  kind(frame: number): FrameKind | null;
  /** The keyframe before a frame, or the next one after it; the frame itself where there is none. */
  keyframe(frame: number, direction: -1 | 1): number;
}

/** What the last picture took. */
export interface Figures {
  /** Drawn within the last second. */
  readonly pictures: number;
  readonly width: number;
  readonly height: number;
  /** Gaussians before the camera. */
  readonly drawn: number;
  readonly sortMs: number;
  readonly uploadMs: number;
  readonly drawMs: number;
  readonly bytesRead: number;
}

/** From one up to, not including, another. */
export type Span = readonly [from: number, to: number];

/** In the element, in CSS pixels. */
export interface Place {
  readonly left: number;
  readonly top: number;
  readonly width: number;
  readonly height: number;
}

/** From where, and through what lens, the scene is looked at. */
export interface View {
  readonly pose: Pose;
  readonly lens: Lens;
}

export interface PlayerApi extends HTMLElement {
  /** What is known of the stream; null before `loadedmetadata`. */
  readonly header: StreamHeader | null;
  /** Of the frame in the picture. */
  readonly info: FrameInfo | null;
  readonly frames: FrameList;
  /** Frames whose bytes are there. */
  readonly bufferedFrames: readonly Span[];
  /** Of a stream in layers, frames for which what refines them is there, too. */
  readonly refinedFrames: readonly Span[];
  readonly fps: number;
  /** Seconds of all frames known so far; NaN before `loadedmetadata`. */
  readonly duration: number;
  readonly paused: boolean;
  readonly ended: boolean;
  currentTime: number;
  /** The frame that is due, counted from 0. */
  currentFrame: number;
  playbackRate: number;
  /** So large a share of the pixels is drawn, and fewer Gaussians, from above 0 to 1. */
  quality: number;
  /** Of a stream that has sound, from 0 to 1. */
  volume: number;
  muted: boolean;
  loop: boolean;
  /** Frames that are played again and again, from one up to, not including, another; null: all are played. */
  range: Span | null;
  controls: boolean;
  /** What is read before somebody plays: nothing, the first picture, or what follows it, too. */
  preload: "none" | "metadata" | "auto";
  overlay: Overlay;
  /** Whether the decoder's own kernel draws: slower, and to the bit what decogs-decode writes. */
  exact: boolean;
  /** Whether this browser leaves a choice: without WebGL2 every picture is exact. */
  readonly canChooseExact: boolean;
  /** Whether a camera of the rig shows what it recorded: its lens, its colours, and where it stood in the frame. */
  recorded: boolean;
  /** Whether what a rig camera recorded lies beside its view, which then is as recorded, too. */
  comparing: boolean;
  /** The name of the rig's camera that is looked through; empty for a free one. */
  camera: string;
  /** null before `loadedmetadata`. */
  readonly view: View | null;
  readonly figures: Figures | null;

  /** Resolves once playing has begun; rejects with what is wrong. After an error it tries again. */
  play(): Promise<void>;
  pause(): void;
  /** The camera as it is now, in a picture as large as the element (or so many pixels). */
  currentCamera(width?: number, height?: number): PinholeCamera | null;
  /** A PNG of the picture, as large as the element or of so many pixels. */
  capture(width?: number, height?: number): Promise<Blob>;
  /** The keyframe at or before a frame from where the scene is looked at now, so many pixels wide; null where there is none. */
  thumbnail(frame: number, width: number): Promise<ImageData | null>;
  /** The frame in the picture as a .ply of 3D Gaussians, in the world that the stream is shown in. */
  ply(): Promise<Blob>;
  /** Looks through a camera of the rig, by its place in `header.cameras`. */
  lookThrough(index: number, atOnce?: boolean): void;
  /** The camera before or after the one looked through last. */
  nextCamera(step: 1 | -1): void;
  /** Back to the camera looked through last. */
  backToCamera(): void;
  /** Looks from anywhere. */
  lookFrom(pose: Pose, lens: Lens): void;
  /** Shows the scene in a headset. To be called while a click is handled; rejects where there is none. */
  enterXr(mode: "immersive-vr" | "immersive-ar"): Promise<void>;
  leaveXr(): Promise<void>;
  /** Flies on until another direction is told: right, up, forward, 1 for the usual speed. */
  fly(direction: Vector): void;
  /** Where the camera's own picture lies in the element; null for a free camera. */
  recordedPlace(): Place | null;
  /** The address of what the camera looked through recorded in the frame that is shown; empty where there is none. */
  recordingAddress(): string;
}
