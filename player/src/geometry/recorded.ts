/**
 * The picture that a camera of the rig recorded: from where it stood in the frame, with its lens and its colours
 * (SPEC section 6, "Corrections"; decoder/rendering/views.py).
 *
 * A wider pinhole is drawn, which sees all that the lens sees, and resampled; then the colours' odds are multiplied.
 */
import type { CameraCorrection, RigCamera } from "../scene";
import { isDistorted, straightening, type LensModel } from "./lens";
import type { LampsNow, PinholeCamera, Recording } from "./camera";

const COLOUR_STEP = 2 ** -12;
const ANGLE_STEP = 2 ** -18;
const LAMP_STEP = 2 ** -12;
const PHASE_STEP = 2 ** -16;
const MOST_LAMP_LIGHT = 8;
/** What is drawn for a lens is at most so many times as wide and as high as the picture. */
const WIDEST = 3;
/** Pixels beyond the outermost sample: the footprint of cubic interpolation. */
const MARGIN = 2;
const LARGEST_SIDE = 8192;

/** The pose of a camera in a frame: turned about its centre as the frame tells. */
export function asItStood(rows: readonly (readonly number[])[], correction: CameraCorrection | null): readonly (readonly number[])[] {
  if (correction === null || (correction.yaw === 0 && correction.pitch === 0 && correction.roll === 0)) return rows;
  const turn = rotation(correction);
  const columns = [0, 1, 2, 3] as const;
  return [0, 1, 2].map((row) => columns.map((column) => [0, 1, 2].reduce((sum, k) => sum + turn[k][row] * rows[k][column], 0)));
}

/** Ry(yaw) Rx(pitch) Rz(roll): from the camera as it stood to the calibrated one. */
function rotation({ yaw, pitch, roll }: CameraCorrection): number[][] {
  const [a, b, c] = [yaw, pitch, roll].map((angle) => angle * ANGLE_STEP) as [number, number, number];
  const [ca, sa, cb, sb, cc, sc] = [Math.cos(a), Math.sin(a), Math.cos(b), Math.sin(b), Math.cos(c), Math.sin(c)];
  return [
    [ca * cc + sa * sb * sc, sa * sb * cc - ca * sc, sa * cb],
    [cb * sc, cb * cc, -sb],
    [ca * sb * sc - sa * cc, sa * sc + ca * sb * cc, ca * cb],
  ];
}

/** What to add to a rig camera's pinhole picture of that scale in a window of that size; null: nothing. */
export function recordingOf(
  camera: RigCamera,
  correction: CameraCorrection | null,
  window: { readonly width: number; readonly height: number; readonly fx: number },
): Recording {
  const scale = window.fx / camera.fx;
  const [width, height] = [scale * camera.width, scale * camera.height];
  const area = { left: (window.width - width) / 2, top: (window.height - height) / 2, width, height };
  const falloff = camera.falloff * COLOUR_STEP;
  const lamps = lampsNow(camera, correction);
  return { lens: isDistorted(camera) ? camera : null, odds: oddsOf(camera, correction), falloff, lamps, ...area };
}

function lampsNow({ lamp, lampAmplitude: always }: RigCamera, correction: CameraCorrection | null): LampsNow | null {
  const lampAmplitude = always + (correction?.lampAmplitude ?? 0);
  if (lamp === null || lampAmplitude === 0) return null;
  const { hertz, readout, columns, rows, sine, cosine } = lamp;
  const cells = new Float32Array(8 * columns * rows);
  const strength = LAMP_STEP * LAMP_STEP * lampAmplitude;
  for (let cell = 0; cell < columns * rows; cell++) {
    for (let c = 0; c < 3; c++) {
      cells[8 * cell + c] = strength * sine[3 * cell + c];
      cells[8 * cell + 4 + c] = strength * cosine[3 * cell + c];
    }
  }
  return { turns: (correction?.lampPhase ?? 0) * PHASE_STEP, turnsDown: hertz * readout, columns, rows, cells };
}

/** Factors on the odds by lamps at a point of the recorded picture, in shares of its width and height. */
export function lampLight({ turns, turnsDown, columns, rows, cells }: LampsNow, across: number, down: number): number[] {
  const x = Math.min(Math.max(across * columns - 0.5, 0), columns - 1);
  const y = Math.min(Math.max(down * rows - 0.5, 0), rows - 1);
  const [left, top] = [Math.floor(x), Math.floor(y)];
  const [right, below] = [Math.min(left + 1, columns - 1), Math.min(top + 1, rows - 1)];
  const at = (c: number): number => {
    const cell = (row: number, column: number): number => cells[8 * (row * columns + column) + c];
    const line = (row: number): number => cell(row, left) + (x - left) * (cell(row, right) - cell(row, left));
    return line(top) + (y - top) * (line(below) - line(top));
  };
  const turn = 2 * Math.PI * (turns + turnsDown * down);
  const [sine, cosine] = [Math.sin(turn), Math.cos(turn)];
  return [0, 1, 2].map((c) => {
    return Math.min(Math.max(1 + at(c) * sine + at(4 + c) * cosine, 1 / MOST_LAMP_LIGHT), MOST_LAMP_LIGHT);
  });
}

function oddsOf({ colours }: RigCamera, correction: CameraCorrection | null): Recording["odds"] {
  const sum = (name: "exposure" | "red" | "blue"): number => (colours?.[name] ?? 0) + (correction?.[name] ?? 0);
  const [exposure, red, blue] = [sum("exposure"), sum("red"), sum("blue")];
  if (exposure === 0 && red === 0 && blue === 0) return null;
  return [Math.exp((exposure + red) * COLOUR_STEP), Math.exp(exposure * COLOUR_STEP), Math.exp((exposure + blue) * COLOUR_STEP)];
}

/** Of a picture through a lens: the pinhole to draw, and where points of the picture lie in that one's. */
export interface LensPlan {
  readonly camera: PinholeCamera;
  /** Points `cell` pixels apart, from `first` pixels on, `columns` x `rows` of them. */
  readonly cell: number;
  readonly first: number;
  readonly columns: number;
  readonly rows: number;
  /** Two numbers a point, pixels of the drawn picture; `NOWHERE` where the lens puts no direction. */
  readonly positions: Float32Array<ArrayBuffer>;
}

export const NOWHERE = -1e9;

/** `cell` 1: every pixel's centre; otherwise corners of cells, between which positions are nearly linear. */
export function lensPlan(camera: PinholeCamera, lens: LensModel, cell: number): LensPlan {
  const first = cell === 1 ? 0.5 : 0;
  const points = (length: number): number => (cell === 1 ? length : Math.ceil(length / cell) + 1);
  const [columns, rows] = [points(camera.width), points(camera.height)];
  const positions = new Float32Array(2 * columns * rows).fill(NOWHERE);
  const straighten = straightening(lens);
  const range = [new Range(camera.width), new Range(camera.height)] as const;
  for (let row = 0, at = 0; row < rows; row++) {
    const y = (first + row * cell - camera.cy) / camera.fy;
    for (let column = 0; column < columns; column++, at += 2) {
      const direction = straighten((first + column * cell - camera.cx) / camera.fx, y);
      if (direction === null) continue;
      positions[at] = direction[0] * camera.fx + camera.cx;
      positions[at + 1] = direction[1] * camera.fy + camera.cy;
      range[0].add(positions[at]);
      range[1].add(positions[at + 1]);
    }
  }
  const [[left, right], [top, bottom]] = [range[0].pixels(), range[1].pixels()];
  for (let at = 0; at < positions.length; at += 2) {
    if (positions[at] === NOWHERE) continue;
    positions[at] -= left;
    positions[at + 1] -= top;
  }
  const drawn = { width: right - left, height: bottom - top, cx: camera.cx - left, cy: camera.cy - top };
  return { camera: { ...camera, ...drawn, recording: null }, cell, first, columns, rows, positions };
}

/** Whole pixels that hold some positions with their margin, at most `WIDEST` pictures. */
class Range {
  private least = Infinity;
  private most = -Infinity;

  constructor(private readonly size: number) {}

  add(position: number): void {
    if (position < this.least) this.least = position;
    if (position > this.most) this.most = position;
  }

  pixels(): readonly [number, number] {
    const { size } = this;
    const spare = Math.max(0, Math.floor(Math.min((WIDEST - 1) * size, LARGEST_SIDE - size) / 2));
    const first = Math.max(Math.floor(this.least) - MARGIN, -spare);
    const last = Math.min(Math.ceil(this.most) + MARGIN, size + spare);
    return first < last ? [first, last] : [0, size];
  }
}

/** The four weights of cubic interpolation at a fraction of a pixel, as OpenCV has them. */
export function cubicWeights(t: number): readonly [number, number, number, number] {
  const A = -0.75;
  const near = (d: number): number => ((A + 2) * d - (A + 3)) * d * d + 1;
  const far = (d: number): number => ((A * d - 5 * A) * d + 8 * A) * d - 4 * A;
  const [a, b, c] = [far(t + 1), near(t), near(1 - t)];
  return [a, b, c, 1 - a - b - c];
}

/** What fall-off leaves of the light at a point of the drawn pinhole's picture; 1 where its lens puts nothing. */
export function lightLeft(falloff: number, drawn: PinholeCamera, x: number, y: number): number {
  if (falloff === 0 || x === NOWHERE) return 1;
  const [across, down] = [(x - drawn.cx) / drawn.fx, (y - drawn.cy) / drawn.fy];
  return (1 + falloff * (across * across + down * down)) ** -2;
}

/** A colour with its odds multiplied; what lies outside 0 to 1 stays. */
export function withOdds(value: number, odds: number): number {
  return value >= 0 && value <= 1 ? Math.min(1, (odds * value) / (1 + (odds - 1) * value)) : value;
}
