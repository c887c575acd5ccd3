/**
 * The exact picture as a camera recorded it: the kernel's floats, resampled through the lens, in the camera's colours; and
 * that of a subject, whose own colours are what is left when alpha is divided out.
 */
import type { PinholeCamera, Recording } from "../geometry/camera";
import { NOWHERE, cubicWeights, lampLight, lensPlan, lightLeft, withOdds, type LensPlan } from "../geometry/recorded";
import type { Gaussians, StreamHeader } from "../scene";
import type { ExactRenderer } from "./renderer";

const NO_ODDS = [1, 1, 1] as const;
const BLACK = [0, 0, 0] as const;
const NOTHING = [0] as const;

/** A picture that is as its pinhole camera sees it. */
export function asSeen({ width, height }: PinholeCamera): Recording {
  return { lens: null, odds: null, falloff: 0, lamps: null, left: 0, top: 0, width, height };
}

/** RGBA, straight, opaque but for a subject; black, or nothing, beside the camera's own picture. */
export function recordedPixels(
  exact: ExactRenderer,
  gaussians: Gaussians,
  header: StreamHeader,
  camera: PinholeCamera,
  recording: Recording,
): Uint8ClampedArray<ArrayBuffer> {
  const plan = recording.lens === null ? null : planOf(camera, recording.lens);
  const drawn = plan === null ? camera : { ...camera, ...sizes(plan.camera) };
  const { subject } = header;
  const background = subject ? BLACK : header.background;
  const { rgb, alpha } = exact.planes(gaussians, header.shDegree, drawn, background);
  const { width, height } = camera;
  const pixels = new Uint8ClampedArray(4 * width * height);
  const { falloff, lamps } = recording;
  const odds = recording.odds ?? NO_ODDS;
  const isColoured = recording.odds !== null || falloff !== 0 || lamps !== null;
  const [colour, covered] = [new Float64Array(3), Float64Array.of(1)];
  const [right, bottom] = [recording.left + recording.width, recording.top + recording.height];
  for (let y = 0, at = 0; y < height; y++) {
    for (let x = 0; x < width; x++, at += 4) {
      pixels[at + 3] = subject ? 0 : 255;
      if (x + 0.5 < recording.left || x + 0.5 > right || y + 0.5 < recording.top || y + 0.5 > bottom) continue;
      const pixel = y * width + x;
      if (plan === null) for (let c = 0; c < 3; c++) colour[c] = rgb[c * height * width + pixel];
      else sample(rgb, drawn, plan.positions, 2 * pixel, background, colour);
      if (subject) {
        if (plan === null) covered[0] = alpha[pixel];
        else sample(alpha, drawn, plan.positions, 2 * pixel, NOTHING, covered);
        const share = Math.min(1, Math.max(0, covered[0]));
        pixels[at + 3] = Math.fround(255 * share);
        for (let c = 0; c < 3; c++) colour[c] = share > 0 ? Math.fround(colour[c] / share) : 0;
      }
      const light =
        plan === null
          ? lightLeft(falloff, drawn, x + 0.5, y + 0.5)
          : lightLeft(falloff, drawn, plan.positions[2 * pixel], plan.positions[2 * pixel + 1]);
      const [across, down] = [(x + 0.5 - recording.left) / recording.width, (y + 0.5 - recording.top) / recording.height];
      const flicker = lamps === null ? NO_ODDS : lampLight(lamps, across, down);
      // Clamped, and rounded with halves to even, as a canvas' bytes are; products as the decoder's floats have them.
      for (let c = 0; c < 3; c++) {
        pixels[at + c] = Math.fround(255 * (isColoured ? withOdds(colour[c], odds[c] * light * flicker[c]) : colour[c]));
      }
    }
  }
  return pixels;
}

function sizes({ width, height, cx, cy }: PinholeCamera): Pick<PinholeCamera, "width" | "height" | "cx" | "cy"> {
  return { width, height, cx, cy };
}

/** Cubic interpolation in as many planes as `result` has numbers; the background where nothing was drawn. */
function sample(
  planes: Float32Array,
  { width, height }: PinholeCamera,
  positions: Float32Array,
  at: number,
  background: readonly number[],
  result: Float64Array,
): void {
  const [x, y] = [positions[at] - 0.5, positions[at + 1] - 0.5];
  if (positions[at] === NOWHERE || x < 0 || y < 0 || x > width - 1 || y > height - 1) {
    result.set(background);
    return;
  }
  const [left, top] = [Math.floor(x), Math.floor(y)];
  const across = cubicWeights(x - left);
  const down = cubicWeights(y - top);
  result.fill(0);
  for (let j = 0; j < 4; j++) {
    const row = Math.min(height - 1, Math.max(0, top + j - 1));
    for (let i = 0; i < 4; i++) {
      const from = row * width + Math.min(width - 1, Math.max(0, left + i - 1));
      const weight = across[i] * down[j];
      for (let c = 0; c < result.length; c++) result[c] += weight * planes[c * width * height + from];
    }
  }
}

/** That of the lens and size asked for last: a camera is looked through for longer than one picture. */
let last: { readonly of: string; readonly plan: LensPlan } | null = null;

function planOf(camera: PinholeCamera, lens: NonNullable<Recording["lens"]>): LensPlan {
  const { width, height, fx, fy, cx, cy } = camera;
  const of = JSON.stringify([width, height, fx, fy, cx, cy, lens.distortionModel, lens.distortion]);
  if (last?.of !== of) last = { of, plan: lensPlan(camera, lens, 1) };
  return last.plan;
}
