/** Where Gaussians are after a packet took some away and added others. */

import { rowsBetween } from "../entropy/rising";
import type { State } from "./state";

/** Slots for so many new Gaussians: those of the removed ones first, then those beyond the last. */
export function slotsForNew(state: State, freed: Uint32Array, added: number): Uint32Array {
  const reused = Math.min(freed.length, added);
  const behind = rowsBetween(state.count, state.count + added - reused);
  if (reused === 0) return behind;
  const slots = new Uint32Array(added);
  slots.set(freed.subarray(0, reused));
  slots.set(behind, reused);
  return slots;
}

/**
 * Closes up the rows behind those removed, puts the new ones behind the rows up to `end` (of before), and moves the last
 * Gaussians into slots that stay empty. Returns the slots whose Gaussians moved; `move` is told of each.
 */
export function closeUp(
  state: State,
  removed: Uint32Array,
  freed: Uint32Array,
  taken: Uint32Array,
  move: (from: number, to: number) => void,
  end = state.count,
): Uint32Array {
  const { order } = state;
  const behind = state.count - end;
  const kept = closeRows(order, state.count, removed);
  const at = kept - behind;
  order.copyWithin(at + taken.length, at, kept);
  order.set(taken, at);
  state.count = kept + taken.length;
  state.inOrder &&= removed.length === 0 && (behind === 0 || taken.length === 0);
  return fillHoles(state, freed.subarray(Math.min(freed.length, taken.length)), move);
}

/** Takes rows out of the order; returns how many are left. */
function closeRows(order: Uint32Array, count: number, removed: Uint32Array): number {
  let end = removed.length > 0 ? removed[0] : count;
  for (let i = 0; i < removed.length; i++) {
    const from = removed[i] + 1;
    const to = i + 1 < removed.length ? removed[i + 1] : count;
    order.copyWithin(end, from, to);
    end += to - from;
  }
  return end;
}

/** Slots below the count must all be taken: Gaussians beyond it move into the holes. */
function fillHoles(state: State, holes: Uint32Array, move: (from: number, to: number) => void): Uint32Array {
  const { order, count } = state;
  const inside = holes.filter((slot) => slot < count);
  if (inside.length === 0) return inside;
  let next = 0;
  for (let row = 0; next < inside.length; row++) {
    if (order[row] < count) continue;
    move(order[row], inside[next]);
    order[row] = inside[next++];
  }
  return inside;
}
