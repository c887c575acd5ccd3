/** What the payloads of frame packets hold (SPEC section 6), read whole before anything is changed by it. */

import { refuse } from "../container/errors";
import type { Fields } from "../container/fields";
import { ID_END } from "../container/limits";
import { readVarints } from "../entropy/blocks";
import { readIndexSet } from "../entropy/indexSets";
import { rowsBetween } from "../entropy/rising";
import { readGroup, type Role } from "../entropy/planes";
import { GROUP } from "./groups";
import type { Groups, Ids, State } from "./state";

/** How rows of a state change, and which go. */
export interface Changes {
  readonly touched: Uint32Array;
  readonly residuals: Groups;
  readonly removed: Uint32Array;
}

export interface Delta extends Changes {
  readonly added: number;
  readonly values: Groups;
}

export interface KeyHead {
  readonly nextId: bigint;
  readonly count: number;
  /** Whether the packet refers to the stream's first keyframe. */
  readonly refers: boolean;
  readonly listsIds: boolean;
  readonly firstListed: bigint;
}

/** What a key packet holds behind its head; `changes` is null where it refers to nothing. */
export interface KeyBody {
  readonly changes: Changes | null;
  readonly ids: Ids;
  readonly values: Groups;
}

/** Ids below this are mostly those of a first keyframe: they are not counted up one by one. */
const MOST_RISING = 1 << 21;

const NOTHING: Groups = [null, null, null, null, null, null];

/** Stands behind the digest. */
export function readKeyHead(fields: Fields, maxGaussians: number): KeyHead {
  const nextId = fields.u64();
  const count = fields.u32();
  if (nextId >= ID_END) refuse("bad-payload", "the next id is 2^63 or above");
  checkCount(count, maxGaussians);
  const reference = fields.u8();
  const idMode = fields.u8();
  if (reference > 1) refuse("unsupported-mode", `reference ${reference} is unknown`);
  if (idMode > 1) refuse("unsupported-mode", `id mode ${idMode} is unknown`);
  return { nextId, count, refers: reference === 1, listsIds: idMode === 1, firstListed: fields.u64() };
}

export function checkCount(count: number, maxGaussians: number): void {
  if (count > maxGaussians) {
    refuse("too-many-gaussians", `${count} Gaussians are above the limit of ${maxGaussians}`);
  }
}

/** `first`: the stream's first keyframe, where the packet refers to it. */
export function readKeyBody(fields: Fields, head: KeyHead, first: State | null, channels: readonly number[]): KeyBody {
  const changes = first === null ? null : readChanges(fields, first.count, channels);
  const listed = first === null || changes === null ? head.count : readListed(fields, head, first, changes);
  if (listed === 0 && head.firstListed !== 0n) refuse("bad-payload", "the first id of no Gaussians is not 0");
  const coded = listed > 0 || changes === null;
  const ids = coded ? readIds(fields, head, listed) : consecutiveIds(0n, 0);
  const values = coded ? readGroups(fields, channels, listed, "values") : NOTHING;
  fields.finish();
  return { changes, ids, values };
}

function readListed(fields: Fields, head: KeyHead, first: State, { removed }: Changes): number {
  const listed = fields.u32();
  if (head.count !== first.count - removed.length + listed) refuse("bad-payload", "a keyframe's counts disagree");
  if (listed > 0 && head.firstListed < first.nextId) refuse("bad-payload", "a keyframe lists an id of the first one");
  return listed;
}

/** What a delta has to fit: a state, or a block of one. */
export type Population = Pick<State, "count" | "channels" | "nextId">;

export function readDelta(fields: Fields, state: Population, maxGaussians: number): Delta {
  const changes = readChanges(fields, state.count, state.channels);
  const added = fields.u32();
  checkCount(state.count - changes.removed.length + added, maxGaussians);
  if (state.nextId + BigInt(added) >= ID_END) refuse("bad-payload", "ids would pass 2^63");
  const values = added > 0 ? readGroups(fields, state.channels, added, "values") : NOTHING;
  fields.finish();
  return { ...changes, added, values };
}

function readChanges(fields: Fields, population: number, channels: readonly number[]): Changes {
  const touched = readIndexSet(fields, population);
  const residuals = touched.length > 0 ? readGroups(fields, channels, touched.length, "residuals") : NOTHING;
  return { touched, residuals, removed: readIndexSet(fields, population) };
}

/** Presence byte and groups. */
function readGroups(fields: Fields, channels: readonly number[], rows: number, role: Role): Groups {
  const presence = fields.u8();
  if (presence >> 6 || (channels[GROUP.SH_REST] === 0 && presence >> GROUP.SH_REST)) {
    refuse("reserved-bits", "reserved bits of a presence byte are set");
  }
  return channels.map((count, group) =>
    (presence >> group) & 1 ? readGroup(fields, group === GROUP.MEANS, count, rows, role) : null,
  );
}

function readIds(fields: Fields, { listsIds, firstListed }: KeyHead, listed: number): Ids {
  if (!listsIds) return consecutiveIds(firstListed, listed);
  return idsAt(firstListed, listed, readVarints(fields, Math.max(0, listed - 1)));
}

export function consecutiveIds(first: bigint, count: number): Ids {
  return idsAt(first, count, null);
}

/** They may pass 2^63, which whoever compares them with the next id finds, and not 2^64. `distances` null: all 0. */
function idsAt(first: bigint, count: number, distances: Float64Array | null): Ids {
  let low = Number(first & 0xffffffffn);
  let high = Number(first >> 32n);
  if (distances === null && high === 0 && low + count <= MOST_RISING) {
    return { low: rowsBetween(low, low + count), high: new Uint32Array(count) };
  }
  const ids = { low: new Uint32Array(count), high: new Uint32Array(count) };
  for (let i = 0; i < count; i++) {
    ids.low[i] = low;
    ids.high[i] = high;
    low += distances === null ? 1 : distances[i] + 1;
    if (low < 2 ** 32) continue;
    high += Math.floor(low / 2 ** 32);
    low %= 2 ** 32;
  }
  return ids;
}
