/** The scene of the frame shown last, packed for textures, and what of it the page has to be sent. */
import type { SceneFrame } from "../scene";
import { perLine, textureLines, type SceneUpdate, type TextureLayout } from "../messages";
import type { Buffers } from "./buffers";
import { Heat } from "./heat";
import { BASE_WORDS, packBase, packRest } from "./packing";

/** Above this share of changed rows everything is sent: one upload of a whole texture costs less than many rows. */
const MOST_ROWS = 0;

export class PackedScene {
  private count = 0;
  private base = new Uint32Array(0);
  private rest = new Uint32Array(0);
  private readonly heat = new Heat();
  private readonly restWords: number;
  private readonly coefficients: number;

  constructor(
    layout: TextureLayout,
    private readonly buffers: Buffers,
  ) {
    this.restWords = 4 * layout.restTexels;
    this.coefficients = (layout.shDegree + 1) ** 2;
  }

  /** Packs what a frame changed; what the page needs for it, null when nothing. */
  take(frame: SceneFrame): SceneUpdate | null {
    const before = this.count;
    const { gaussians } = frame;
    this.reserve(gaussians.count);
    this.count = gaussians.count;
    const rows = frame.changedRows === null ? null : withAdded(frame.changedRows, before, gaussians.count);
    const warm = this.heat.take(frame, rows, before);
    if (rows === null) {
      for (let row = 0; row < this.count; row++) this.pack(frame, row);
      return this.whole();
    }
    for (const row of rows) this.pack(frame, row);
    if (rows.length === 0 && before === this.count && !warm) return null;
    return rows.length > MOST_ROWS * this.count ? this.whole() : this.part(rows);
  }

  /** Everything, for a page that has nothing yet. */
  whole(): SceneUpdate {
    const base = this.lines(this.base, BASE_WORDS);
    const rest = this.restWords > 0 ? this.lines(this.rest, this.restWords) : null;
    return { count: this.count, rows: null, base, rest, heat: this.heat.bytes(this.count, this.buffers) };
  }

  /** A copy of all rows, as long as the lines of a texture that hold them. */
  private lines(words: Uint32Array, width: number): Uint32Array {
    const texels = width / 4;
    const copy = this.buffers.words(width * perLine(texels) * textureLines(this.count, texels));
    copy.set(words.subarray(0, width * this.count));
    return copy;
  }

  private part(rows: Uint32Array): SceneUpdate {
    const base = gathered(this.base, BASE_WORDS, rows, this.buffers);
    const rest = this.restWords > 0 ? gathered(this.rest, this.restWords, rows, this.buffers) : null;
    return { count: this.count, rows, base, rest, heat: this.heat.bytes(this.count, this.buffers) };
  }

  private pack(frame: SceneFrame, row: number): void {
    packBase(frame.gaussians, this.coefficients, row, this.base, BASE_WORDS * row);
    if (this.restWords > 0) packRest(frame.gaussians, this.coefficients, row, this.rest, this.restWords * row);
  }

  private reserve(count: number): void {
    if (BASE_WORDS * count <= this.base.length) return;
    const rows = Math.ceil(count * 1.25);
    this.base = grown(this.base, BASE_WORDS * rows);
    this.rest = grown(this.rest, this.restWords * rows);
  }
}

/** Changed rows and those that were not there before. */
function withAdded(changed: Uint32Array, before: number, count: number): Uint32Array {
  let known = changed.length;
  while (known > 0 && changed[known - 1] >= before) known--;
  if (count <= before) return changed.slice(0, known);
  const rows = new Uint32Array(known + count - before);
  rows.set(changed.subarray(0, known));
  for (let row = before; row < count; row++) rows[known + row - before] = row;
  return rows;
}

function gathered(words: Uint32Array, width: number, rows: Uint32Array, buffers: Buffers): Uint32Array {
  const part = buffers.words(width * rows.length);
  let to = 0;
  for (const row of rows) {
    for (let i = 0, from = width * row; i < width; i++) part[to++] = words[from++]!;
  }
  return part;
}

function grown(words: Uint32Array, length: number): Uint32Array<ArrayBuffer> {
  const larger = new Uint32Array(length);
  larger.set(words);
  return larger;
}
