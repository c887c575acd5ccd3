/** Cameras as plain data: what draws and what moves them share it. */
import type { LensModel } from "./lens";

/** Size, focal lengths and principal point in pixels, and the nearest depth that is drawn. */
export interface Lens {
  readonly width: number;
  readonly height: number;
  readonly fx: number;
  readonly fy: number;
  readonly cx: number;
  readonly cy: number;
  readonly near: number;
}

/** The lens of OpenGL's projection `p`, by columns, in a picture of this size. */
export function lensOf(p: ArrayLike<number>, width: number, height: number, near: number): Lens {
  return {
    width,
    height,
    fx: (p[0] * width) / 2,
    fy: (p[5] * height) / 2,
    cx: ((1 - p[8]) * width) / 2,
    cy: ((1 + p[9]) * height) / 2,
    near,
  };
}

/** A camera without a lens' distortion: pixels from the picture's top left corner, axes x right, y down, z forward. */
export interface PinholeCamera extends Lens {
  /** Three rows of four. */
  readonly worldToCamera: readonly (readonly number[])[];
  /** What the picture has beside that of the pinhole, if it is to look as it was recorded. */
  readonly recording?: Recording | null;
}

/** The wave of lamps over a picture at one time: 1 + sine sin + cosine cos of its turns, within 1/8 to 8. */
export interface LampsNow {
  /** In the first row, and from there to the last. */
  readonly turns: number;
  readonly turnsDown: number;
  readonly columns: number;
  readonly rows: number;
  /** Strengths at the middles of cells, row by row: sine of red, green and blue, 0, and cosine of them, 0. */
  readonly cells: Float32Array<ArrayBuffer>;
}

/** What a picture has beside that of its pinhole camera. */
export interface Recording {
  /** null: no distortion. */
  readonly lens: LensModel | null;
  /** Multiply the odds v / (1 - v) of red, green and blue; null: nothing does. */
  readonly odds: readonly [number, number, number] | null;
  /** Odds are divided by (1 + falloff t^2)^2 at the tangent t of the angle to the camera's axis; 0: nowhere. */
  readonly falloff: number;
  /** Flickering lamps, whose light multiplies the odds; null: none. */
  readonly lamps: LampsNow | null;
  /** The camera's own picture, in pixels of the canvas; nothing was recorded beside it. */
  readonly left: number;
  readonly top: number;
  readonly width: number;
  readonly height: number;
}
