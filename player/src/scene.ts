/**
 * What the decoder hands to everything that draws: the stream's header, and the scene of one frame.
 *
 * Names are those of formats/SPEC.md in camel case. Everything here is plain data, so that it crosses from a worker to
 * the page as it is.
 */

import type { Lens } from "./geometry/camera";
import type { LensModel } from "./geometry/lens";
import type { Similarity } from "./geometry/similarity";

/** Kinds of frames, as packets name them (SPEC section 3). */
export type FrameKind = "key" | "delta" | "skip";

/** A camera of the rig (SPEC section 4). Lengths in pixels; the picture's top left corner is (0, 0). */
export interface RigCamera extends Lens, LensModel {
  readonly name: string;
  /** Three rows of four: a rotation and a translation; camera axes x right, y down, z forward. */
  readonly worldToCamera: readonly (readonly number[])[];
  /** What this camera's colours differ by in every frame; null where the stream does not say. */
  readonly colours: CameraColours | null;
  /** How much darker its pictures are towards the border, in 1/4096 (SPEC section 6, "Corrections"); 0: not at all. */
  readonly falloff: number;
  /** How lamps that flicker change its pictures (SPEC section 6, "Corrections"); null where none do. */
  readonly lamp: LampWave | null;
  /** What frames' amplitudes of it are added to: all of it, 4096, where no frame tells of it. */
  readonly lampAmplitude: number;
}

/** A wave over the rows of a camera's pictures (SPEC section 4): strengths in 1/4096, red, green and blue of each cell. */
export interface LampWave {
  readonly hertz: number;
  readonly readout: number;
  readonly columns: number;
  readonly rows: number;
  readonly sine: readonly number[];
  readonly cosine: readonly number[];
}

/** How a camera recorded colours, in 1/4096 of a natural logarithm (SPEC section 6, "Corrections"). */
export interface CameraColours {
  readonly exposure: number;
  readonly red: number;
  readonly blue: number;
}

/**
 * What one frame tells of a camera: colours, to which the camera's own `colours` are to be added, its pose in
 * 1/262144 radians, and its lamps. Numbers that the stream does not tell are 0.
 */
export interface CameraCorrection extends CameraColours {
  readonly yaw: number;
  readonly pitch: number;
  readonly roll: number;
  /** In 1/65536 of a turn. */
  readonly lampPhase: number;
  /** In 1/4096 of the camera's `lamp`. */
  readonly lampAmplitude: number;
}

/** Steps of the lattice that coded integers lie on (SPEC sections 4 and 5). */
export interface Lattice {
  readonly origin: readonly number[];
  readonly means: readonly number[];
  readonly logScales: number;
  readonly quaternions: number;
  readonly opacityLogits: number;
  readonly shDc: number;
  readonly shRest: number;
}

/** The header packet (SPEC section 4), as far as a viewer needs it. */
export interface StreamHeader {
  readonly cameras: readonly RigCamera[];
  readonly lattice: Lattice;
  readonly shDegree: number;
  /** Frames per second; null when the stream does not say. */
  readonly fps: number | null;
  /** The source's index of frame 0. */
  readonly firstFrame: number;
  /** Display-referred red, green, blue behind the scene. */
  readonly background: readonly number[];
  readonly effects: readonly string[];
  readonly heldOut: readonly string[];
  /** By effect, the cameras of which every frame's corrections tell. */
  readonly corrected: ReadonlyMap<string, readonly string[]>;
  /** Whether this is a subject without its surroundings: what it does not cover is not black but nothing. */
  readonly subject: boolean;
  readonly presentation: Presentation;
  readonly sound: readonly SoundTrack[];
  /** The base, and what refines it; none where the frames' packets hold the whole scene. */
  readonly layers: readonly Layer[];
}

/** A layer with all below it (SPEC section 4). */
export interface Layer {
  /** The most in any frame. */
  readonly gaussians: number;
  /** Mean on disk. */
  readonly bytesPerFrame: number;
  /** In dB, against all layers together; null of those. */
  readonly psnr: number | null;
}

/** How a stream wants to be shown (SPEC section 4). null and the empty text: it does not say. */
export interface Presentation {
  readonly title: string;
  /** The frame that stands for the stream. */
  readonly poster: number | null;
  /** The camera to begin with, by name. */
  readonly firstView: string | null;
  /** Takes scene and cameras as they are stored to the world that the stream is shown in. */
  readonly transform: Similarity | null;
}

/** A track of sound; all are played together. */
export interface SoundTrack {
  readonly channels: 1 | 2;
  /** Where in the scene it comes from; null: it has no place. */
  readonly position: readonly [number, number, number] | null;
}

/** Coded blocks of a track, without a gap; the first begins so many samples after its frame. */
export interface SoundPacket {
  readonly track: number;
  readonly offset: number;
  readonly blocks: readonly Uint8Array<ArrayBuffer>[];
}

/** The sound of one frame. */
export interface SoundFrame {
  readonly frame: number;
  readonly packets: readonly SoundPacket[];
}

/** What is known of a frame without decoding it: from the index packet, or from packet headers seen so far. */
export interface FrameEntry {
  /** null for a frame whose packet is lost. */
  readonly kind: FrameKind | null;
  /** Bytes on disk, the packet's own header and checksums included. */
  readonly bytes: number;
}

/**
 * Stored values of all Gaussians (SPEC section 5). Scales, opacities and colours are not activated yet.
 *
 * A Gaussian keeps its slot in the arrays for as long as it can: one that is added takes the slot of one that was
 * removed. So slots are not the rows of SPEC.md, which close up; `order` tells the two apart.
 */
export interface Gaussians {
  /** Number of Gaussians; arrays may be longer. */
  readonly count: number;
  /** count x 3, world units. */
  readonly means: Float32Array;
  /** count x 3, natural logarithms of world units. */
  readonly logScales: Float32Array;
  /** count x 4, w x y z, of any norm. */
  readonly quaternions: Float32Array;
  /** count. */
  readonly opacityLogits: Float32Array;
  /** count x (shDegree + 1)^2 x 3, spherical harmonics of colour; colour = 0.5 + SH(direction). */
  readonly sh: Float32Array;
  /**
   * By slot, where the decoder keeps it: the frame whose packet last changed or added the Gaussian, that of the
   * keyframe for those untouched since. So it is right after a seek, too.
   */
  readonly lastChanged?: Int32Array;
  /** The slot of each row, for what must take Gaussians in the stream's order; null where slots are rows. */
  readonly order: Uint32Array | null;
}

/** The scene of one frame, and what its packet changed. Arrays belong to the decoder and change with the next frame. */
export interface SceneFrame {
  /** Counted from 0. */
  readonly frame: number;
  /** null where the packet is damaged: then the scene is that of the last good frame. */
  readonly kind: FrameKind | null;
  readonly bytes: number;
  /** The top layer that the scene has, 0 the base. */
  readonly layer: number;
  /** What is wrong with this frame, one sentence with the reason code of SPEC section 9; null when nothing is. */
  readonly damage: string | null;
  readonly gaussians: Gaussians;
  /**
   * Slots in the arrays whose values may differ from those of the frame that the decoder gave before this one, slots
   * beyond that one's count included, each once; null when all must be taken as changed.
   */
  readonly changedRows: Uint32Array | null;
  /** Gaussians that this frame's packet changed, added and removed: 0 of all for a frame that only repeats. */
  readonly changed: number;
  readonly added: number;
  readonly removed: number;
  /** By name, the cameras that this frame tells of; any other camera differs by its `colours` at most. */
  readonly corrections: ReadonlyMap<string, CameraCorrection>;
}

/** Encoder's figures of a frame, where the stream carries a METRICS packet for it. */
export interface FrameMetrics {
  readonly psnr: number | null;
}

/** A keyframe that was decoded aside. */
export interface Still {
  readonly frame: number;
  readonly gaussians: Gaussians;
}

/** A stream that is open: bytes come as they are needed. All methods reject with a StreamError. */
export interface SceneStream {
  readonly header: StreamHeader;
  /** Frames known so far; grows while the source grows. */
  readonly frames: readonly FrameEntry[];
  /** Whether the end of the stream was seen: false while a source still grows. */
  readonly complete: boolean;
  /** Whether all that is there was seen, and it has no end: more may come, or the stream is cut off. */
  readonly waits: boolean;
  /** Figures by frame, for those that have any. */
  readonly metrics: ReadonlyMap<number, FrameMetrics>;
  /** Bytes read from the source so far. */
  readonly bytesRead: number;
  /** Frames whose bytes are there, from one up to, not including, another. */
  readonly buffered: readonly (readonly [number, number])[];
  /** Of a stream in layers, frames for which what refines them is there, too. */
  readonly refined: readonly (readonly [number, number])[];
  /** What of the bytes that lead to a frame from its keyframe on is there, from 0 to 1. */
  share(frame: number): number;
  /** Why nothing comes, while that is tried again; null when nothing is wrong. */
  readonly trouble: string | null;
  /** What is wrong with the stream as a whole, each one sentence: damage that costs no frame, an end that is cut off. */
  readonly notices: readonly string[];
  /** The scene at a frame. Going one frame on costs one packet; going elsewhere reads and decodes from its keyframe. */
  frame(index: number, signal?: AbortSignal): Promise<SceneFrame>;
  /** The keyframe at or before a frame, while another frame is shown; one at a time, and in memory of its own. */
  keyframe(index: number): Promise<Still>;
  /** Decodes layers up to here, from the next frame on. */
  keepWithin(budget: { readonly gaussians?: number; readonly bitsPerSecond?: number }): void;
  /** Has what refines a frame come, to be there when that is asked for again; resolves to whether there is any. */
  refine(frame: number): Promise<boolean>;
  /** Reads bytes of the coming frames ahead, within the window that bounds memory. */
  prefetch(from: number): Promise<void>;
  /** The sound of frames from one up to, not including, another, as far as they are known; damage is silence. */
  sound(from: number, to: number): Promise<SoundFrame[]>;
  /** Looks whether the source has grown; resolves to whether it has. */
  refresh(): Promise<boolean>;
  close(): void;
}
