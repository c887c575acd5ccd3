/** Floats from integers (SPEC section 5, "Lattice"): products and sums in float64, rounded when they are stored. */

import type { Lattice } from "../scene";
import { GROUP } from "./groups";
import type { State } from "./state";

const MAX_LOG_SCALE = 40;
const MAX_OPACITY_LOGIT = 80;

/** The stored values of all Gaussians, in the places that they have in the state. */
export interface Floats {
  means: Float32Array;
  logScales: Float32Array;
  quaternions: Float32Array;
  opacityLogits: Float32Array;
  sh: Float32Array;
}

export function noFloats(): Floats {
  return {
    means: new Float32Array(0),
    logScales: new Float32Array(0),
    quaternions: new Float32Array(0),
    opacityLogits: new Float32Array(0),
    sh: new Float32Array(0),
  };
}

/** Makes room for all that fits into the state; what is there stays. */
export function makeRoom(floats: Floats, state: State): void {
  const capacity = state.order.length;
  if (floats.opacityLogits.length >= capacity) return;
  for (const name of Object.keys(floats) as (keyof Floats)[]) {
    const made = new Float32Array(capacity * width(name, state));
    made.set(floats[name]);
    floats[name] = made;
  }
}

function width(name: keyof Floats, { channels }: State): number {
  const group = { means: 0, logScales: 1, quaternions: 2, opacityLogits: 3, sh: 4 }[name];
  return name === "sh" ? channels[GROUP.SH_DC] + channels[GROUP.SH_REST] : channels[group];
}

/** Puts the integers of these places on the lattice; only the groups that `present` says yes to. */
export function dequantise(
  state: State,
  lattice: Lattice,
  floats: Floats,
  places: Uint32Array,
  present: (group: number) => boolean,
): void {
  const { integers, channels } = state;
  if (present(GROUP.MEANS)) placeMeans(integers[GROUP.MEANS], lattice, floats.means, places);
  if (present(GROUP.LOG_SCALES)) {
    limited(integers[GROUP.LOG_SCALES], 3, lattice.logScales, MAX_LOG_SCALE, floats.logScales, places);
  }
  if (present(GROUP.QUATERNIONS)) {
    turn(integers[GROUP.QUATERNIONS], lattice.quaternions, floats.quaternions, places);
  }
  if (present(GROUP.OPACITY_LOGITS)) {
    const step = lattice.opacityLogits;
    limited(integers[GROUP.OPACITY_LOGITS], 1, step, MAX_OPACITY_LOGIT, floats.opacityLogits, places);
  }
  const [dc, rest] = [channels[GROUP.SH_DC], channels[GROUP.SH_REST]];
  if (present(GROUP.SH_DC)) colour(integers[GROUP.SH_DC], dc, lattice.shDc, floats.sh, dc + rest, 0, places);
  if (rest > 0 && present(GROUP.SH_REST)) {
    colour(integers[GROUP.SH_REST], rest, lattice.shRest, floats.sh, dc + rest, dc, places);
  }
}

function placeMeans(integers: Int32Array, { means, origin }: Lattice, floats: Float32Array, places: Uint32Array): void {
  const [stepX, stepY, stepZ] = means;
  const [originX, originY, originZ] = origin;
  for (const place of places) {
    const at = 3 * place;
    floats[at] = integers[at] * stepX + originX;
    floats[at + 1] = integers[at + 1] * stepY + originY;
    floats[at + 2] = integers[at + 2] * stepZ + originZ;
  }
}

function limited(
  integers: Int32Array,
  channels: number,
  step: number,
  most: number,
  floats: Float32Array,
  places: Uint32Array,
): void {
  for (const place of places) {
    for (let at = channels * place; at < channels * (place + 1); at++) {
      const value = integers[at] * step;
      floats[at] = value > most ? most : value < -most ? -most : value;
    }
  }
}

function turn(integers: Int32Array, step: number, floats: Float32Array, places: Uint32Array): void {
  for (const place of places) {
    const at = 4 * place;
    const [w, x, y, z] = [integers[at], integers[at + 1], integers[at + 2], integers[at + 3]];
    floats[at] = (w | x | y | z) === 0 ? 1 : w * step;
    floats[at + 1] = x * step;
    floats[at + 2] = y * step;
    floats[at + 3] = z * step;
  }
}

/** Spherical harmonics: so many channels from `offset` on of each Gaussian's `width`. */
function colour(
  integers: Int32Array,
  channels: number,
  step: number,
  floats: Float32Array,
  width: number,
  offset: number,
  places: Uint32Array,
): void {
  for (const place of places) {
    const from = channels * place;
    const to = width * place + offset;
    for (let channel = 0; channel < channels; channel++) floats[to + channel] = integers[from + channel] * step;
  }
}
