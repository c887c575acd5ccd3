/**
 * What page and worker say to each other: plain data, large arrays as transferred buffers.
 *
 * The worker owns the stream and the packed scene. The page says which frame is due and from where it is looked at; the
 * worker answers with what to upload and in which order to draw. Messages are answered in their order, so that an order
 * always belongs to the frame sent last.
 */
import type { PinholeCamera } from "./geometry/camera";
import type { CameraCorrection, FrameKind, SoundFrame, StreamHeader } from "./scene";

/** Depth of a point along the view: x, y, z weights and an offset, the last row of world-to-camera. */
export type DepthRow = readonly [number, number, number, number];

/** Which stream to open, and how. */
export interface Opening {
  readonly source: string;
  /** It is still being written. */
  readonly follow: boolean;
  /** The frame to show at once, as request 0, without being asked for it; null: none. */
  readonly first: number | null;
  /** Nothing is read ahead until a frame is asked for as request 1 or later. */
  readonly sparing?: boolean;
  /** Another server gets its cookies. */
  readonly credentials?: "include";
}

/** What a stream's layers may take together; without a number, anything. */
export interface Budget {
  readonly gaussians?: number;
  readonly bitsPerSecond?: number;
}

export type ToWorker =
  | ({ readonly type: "open" } & Opening)
  /** Show a frame; the answer is a "frame" or a "failed" message with the same `request`. */
  | { readonly type: "show"; readonly frame: number; readonly request: number }
  /** Look from elsewhere; answered by an "order", with `serial` of the last of several views. */
  | { readonly type: "view"; readonly depth: DepthRow; readonly serial: number }
  /** Draw so large a share of the Gaussians, those that cover most; answered by an "order". */
  | { readonly type: "detail"; readonly share: number }
  /** Layers are decoded up to here, from the next frame on; also before the stream is open. */
  | { readonly type: "budget"; readonly budget: Budget }
  /** Look whether the source has grown. */
  | { readonly type: "refresh" }
  /** Send the whole frame again: the page has lost its textures. */
  | { readonly type: "resend" }
  /** Buffers that the page is done with, for the worker to fill again. */
  | { readonly type: "recycle"; readonly buffers: readonly ArrayBuffer[] }
  /** Draw the scene with the decoder's kernel; answered by an "exact". */
  | { readonly type: "exact"; readonly camera: PinholeCamera }
  /** Draw the keyframe at or before a frame with the kernel; answered by a "still". */
  | { readonly type: "still"; readonly frame: number; readonly camera: PinholeCamera }
  /** Answers a "kernel": the exact picture's kernel; null: it cannot be had, and `problem` says why. */
  | { readonly type: "kernel"; readonly bytes: ArrayBuffer | null; readonly problem: string }
  /** Give the frame that is shown as a .ply; answered by a "ply". */
  | { readonly type: "ply" }
  /** The sound of frames from one up to, not including, another; answered by a "sound" of the same `request`. */
  | { readonly type: "sound"; readonly from: number; readonly to: number; readonly request: number }
  | { readonly type: "close" };

/** A picture that the decoder's kernel drew, RGBA. */
export interface ExactPicture {
  readonly width: number;
  readonly height: number;
  readonly pixels: Uint8ClampedArray<ArrayBuffer>;
  readonly drawMs: number;
}

/** Frames known from `from` on, as columns, since an hour of video has a hundred thousand of them. */
export interface FrameTable {
  readonly from: number;
  /** Indices in `FRAME_KINDS`. */
  readonly kinds: Uint8Array;
  readonly bytes: Uint32Array;
}

/** null: a frame whose packet is lost. */
export const FRAME_KINDS: readonly (FrameKind | null)[] = ["key", "delta", "skip", null];

/** How a Gaussian lies in the data textures (worker/packing.ts). */
export interface TextureLayout {
  readonly shDegree: number;
  /** Texels of four 32-bit words that a Gaussian takes in the texture of higher harmonics: 0 where there are none. */
  readonly restTexels: number;
}

/** Texels in a line of a data texture: every WebGL2 has room for as many. */
export const TEXTURE_WIDTH = 2048;

/** Gaussians in a line of a texture that has so many texels of each, and lines for so many Gaussians. */
export function perLine(texels: number): number {
  return Math.floor(TEXTURE_WIDTH / texels);
}
export function textureLines(count: number, texels: number): number {
  return Math.max(1, Math.ceil(count / perLine(texels)));
}

/**
 * What to upload for a frame: everything, or a part. Words fill whole lines: of the textures that they become where
 * everything is sent, of textures of single texels otherwise.
 */
export interface SceneUpdate {
  readonly count: number;
  /** The rows that the words are of; null: all, from row 0 on. */
  readonly part: { readonly slots: Uint32Array; readonly count: number } | null;
  /** Eight words, two texels, a Gaussian. */
  readonly base: Uint32Array;
  /** Four words a texel; null at degree 0. */
  readonly rest: Uint32Array | null;
  /** A byte a Gaussian (`HEAT`), always of all. */
  readonly heat: Uint8Array;
}

/** What a byte of heat says: 255 changed in this frame; 254 down to 2 so many frames ago; 1 in this segment; 0 never. */
export const HEAT = { now: 255, oldest: 2, earlier: 1, still: 0 } as const;

/** Rows in the order to draw them, nearest first, as long as the lines of a texture that hold them. */
export interface DrawOrder {
  readonly order: Uint32Array;
  readonly count: number;
  readonly sortMs: number;
  /** Of the view that it is for. */
  readonly serial: number;
}

export interface FrameInfo {
  readonly frame: number;
  readonly kind: FrameKind | null;
  readonly bytes: number;
  /** The top layer that the scene has, 0 the base. */
  readonly layer: number;
  readonly damage: string | null;
  readonly count: number;
  readonly changed: number;
  readonly added: number;
  readonly removed: number;
  readonly decodeMs: number;
  readonly packMs: number;
  /** What this frame tells of cameras, by name (SPEC section 6, "Corrections"). */
  readonly corrections: ReadonlyMap<string, CameraCorrection>;
}

/** `picture` null: there is none, and `problem` says why, if something is wrong. `kernel`: whether there is one to ask again. */
export interface ExactAnswer {
  readonly type: "exact";
  readonly picture: ExactPicture | null;
  readonly problem: string | null;
  readonly kernel: boolean;
}

/** The answer of a worker that is gone: nothing is amiss with its kernel. */
export const NO_ANSWER: ExactAnswer = { type: "exact", picture: null, problem: null, kernel: true };

export type FromWorker =
  | {
      readonly type: "opened";
      readonly header: StreamHeader;
      readonly layout: TextureLayout;
      readonly frames: FrameTable;
      readonly complete: boolean;
    }
  | {
      readonly type: "progress";
      readonly bytesRead: number;
      readonly complete: boolean;
      /** Only what is new; null when nothing is. */
      readonly frames: FrameTable | null;
      /** Encoder's PSNR by frame, what is new of it. */
      readonly psnr: readonly (readonly [number, number])[];
      /** What is wrong with the stream as a whole. */
      readonly notices: readonly string[];
      /** Why nothing comes, while that is tried again. */
      readonly trouble: string | null;
      /** Frames whose bytes are there. */
      readonly buffered: readonly (readonly [number, number])[];
      /** Of a stream in layers, frames for which what refines them is there, too. */
      readonly refined: readonly (readonly [number, number])[];
      /** How much of what leads to the frame that is waited for has come, from 0 to 1; null when none is. */
      readonly share: number | null;
    }
  | {
      readonly type: "frame";
      readonly request: number;
      readonly info: FrameInfo;
      /** null when the scene is the one that the page has. */
      readonly update: SceneUpdate | null;
      readonly draw: DrawOrder;
    }
  | { readonly type: "order"; readonly draw: DrawOrder }
  /** The frame to begin with is not known yet; it has to be asked for when it is. */
  | { readonly type: "notYet" }
  | { readonly type: "refreshed"; readonly grown: boolean }
  /** The exact picture's kernel is needed; answered by a "kernel". */
  | { readonly type: "kernel" }
  | ExactAnswer
  /** null: there is none. */
  | { readonly type: "still"; readonly picture: ExactPicture | null }
  /** null: there is none, and `problem` says why. */
  | { readonly type: "ply"; readonly bytes: Uint8Array<ArrayBuffer> | null; readonly problem: string }
  | { readonly type: "sound"; readonly request: number; readonly frames: readonly SoundFrame[] }
  /** `request` null: the stream cannot be opened at all. */
  | { readonly type: "failed"; readonly request: number | null; readonly message: string };
