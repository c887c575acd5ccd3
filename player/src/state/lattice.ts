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

/** Places that all groups are put on the lattice for before the next ones, as long as they are at hand. */
const BATCH = 1024;

/** Puts the integers of these places on the lattice; only the groups that `present` says yes to. */
export function dequantise(
  state: State,
  lattice: Lattice,
  floats: Floats,
  places: Uint32Array,
  present: (group: number) => boolean,
): void {
  const writers = state.channels.map((channels, group) =>
    channels > 0 && present(group) ? writerOf(group, state, lattice, floats) : null,
  );
  for (let from = 0; from < places.length; from += BATCH) {
    const batch = places.subarray(from, from + BATCH);
    for (const write of writers) write?.(batch);
  }
}

type Writer = (places: Uint32Array) => void;

function writerOf(group: number, state: State, lattice: Lattice, floats: Floats): Writer {
  const { integers, width } = state;
  const { logScales, quaternions, opacityLogits, shDc, shRest } = lattice;
  const from: Channels = { integers, width, offset: state.offsets[group], count: state.channels[group] };
  const dc = state.channels[GROUP.SH_DC];
  const all = dc + state.channels[GROUP.SH_REST];
  switch (group) {
    case GROUP.MEANS:
      return (places) => {
        placeMeans(from, lattice, floats.means, places);
      };
    case GROUP.LOG_SCALES:
      return (places) => {
        limit(from, logScales, MAX_LOG_SCALE, floats.logScales, places);
      };
    case GROUP.QUATERNIONS:
      return (places) => {
        turn(from, quaternions, floats.quaternions, places);
      };
    case GROUP.OPACITY_LOGITS:
      return (places) => {
        limit(from, opacityLogits, MAX_OPACITY_LOGIT, floats.opacityLogits, places);
      };
    case GROUP.SH_DC:
      return (places) => {
        colour(from, shDc, floats.sh, all, 0, places);
      };
    default:
      return (places) => {
        colour(from, shRest, floats.sh, all, dc, places);
      };
  }
}

/** A group's channels among all integers of a place. */
interface Channels {
  readonly integers: Int32Array;
  readonly width: number;
  readonly offset: number;
  readonly count: number;
}

function placeMeans(from: Channels, { means, origin }: Lattice, floats: Float32Array, places: Uint32Array): void {
  const { integers, width, offset } = from;
  const [stepX, stepY, stepZ] = means;
  const [originX, originY, originZ] = origin;
  for (let i = 0; i < places.length; i++) {
    const start = (Math.imul(width, places[i]) + offset) | 0;
    const at = Math.imul(3, places[i]);
    floats[at] = integers[start] * stepX + originX;
    floats[at + 1] = integers[start + 1] * stepY + originY;
    floats[at + 2] = integers[start + 2] * stepZ + originZ;
  }
}

function limit(from: Channels, step: number, most: number, floats: Float32Array, places: Uint32Array): void {
  const { integers, width, offset, count } = from;
  for (let i = 0; i < places.length; i++) {
    const start = (Math.imul(width, places[i]) + offset) | 0;
    const at = Math.imul(count, places[i]);
    for (let channel = 0; channel < count; channel++) {
      const value = integers[start + channel] * step;
      floats[at + channel] = value > most ? most : value < -most ? -most : value;
    }
  }
}

function turn(from: Channels, step: number, floats: Float32Array, places: Uint32Array): void {
  const { integers, width, offset } = from;
  for (let i = 0; i < places.length; i++) {
    const start = (Math.imul(width, places[i]) + offset) | 0;
    const at = Math.imul(4, places[i]);
    const w = integers[start];
    const x = integers[start + 1];
    const y = integers[start + 2];
    const z = integers[start + 3];
    floats[at] = (w | x | y | z) === 0 ? 1 : w * step;
    floats[at + 1] = x * step;
    floats[at + 2] = y * step;
    floats[at + 3] = z * step;
  }
}

/** Spherical harmonics, behind the first `skipped` of a Gaussian's `all`. */
function colour(
  from: Channels,
  step: number,
  floats: Float32Array,
  all: number,
  skipped: number,
  places: Uint32Array,
): void {
  const { integers, width, offset, count } = from;
  for (let i = 0; i < places.length; i++) {
    const start = (Math.imul(width, places[i]) + offset) | 0;
    const at = (Math.imul(all, places[i]) + skipped) | 0;
    for (let channel = 0; channel < count; channel++) floats[at + channel] = integers[start + channel] * step;
  }
}
