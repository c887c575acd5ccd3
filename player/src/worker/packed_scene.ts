/** The scene of the frame shown last, packed for textures, and what of it the page has to be sent. */
import type { SceneFrame } from "../scene";
import { TEXTURE_WIDTH, perLine, textureLines, type SceneUpdate, type TextureLayout } from "../messages";
import type { Buffers } from "./buffers";
import { heatOf } from "./heat";
import { BASE_WORDS, packBase, packRest } from "./packing";

/** Above this share of changed rows everything is sent: one upload of a whole texture costs less than many rows. */
const MOST_ROWS = 0.25;
/** Of rows, beyond those that are there: so that a scene which grows is not sent anew at once. */
const SPARE = 0.1;

export class PackedScene {
  private count = 0;
  private base = new Uint32Array(0);
  private rest = new Uint32Array(0);
  private scene: SceneFrame | null = null;
  /** Rows for which the page's textures have room. */
  private room = 0;
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
    const rows = frame.changedRows;
    const moved = frame.frame !== this.scene?.frame; // then the glow of what changed is another one
    this.scene = frame;
    if (rows === null) {
      for (let row = 0; row < this.count; row++) this.pack(frame, row);
      return this.whole();
    }
    if (rows.length === 0 && before === this.count && !moved) return null;
    if (rows.length <= MOST_ROWS * this.count && this.count <= this.room) return this.part(frame, rows);
    for (const row of rows) this.pack(frame, row);
    return this.whole();
  }

  /** Everything, for a page that has nothing yet. */
  whole(): SceneUpdate {
    this.room = Math.ceil(this.count * (1 + SPARE));
    const base = this.lines(this.base, BASE_WORDS);
    const rest = this.restWords > 0 ? this.lines(this.rest, this.restWords) : null;
    return { count: this.count, part: null, base, rest, heat: heatOf(this.scene!, this.buffers) };
  }

  /** A copy of all rows, as long as the lines of a texture that has room for them and some more. */
  private lines(words: Uint32Array, width: number): Uint32Array {
    const texels = width / 4;
    const copy = this.buffers.words(width * perLine(texels) * textureLines(this.room, texels));
    copy.set(words.subarray(0, width * this.count));
    return copy;
  }

  /** Packs rows, and copies each while it is still in the cache. */
  private part(frame: SceneFrame, rows: Uint32Array): SceneUpdate {
    const { restWords } = this;
    const base = this.staged(BASE_WORDS * rows.length);
    const rest = restWords > 0 ? this.staged(restWords * rows.length) : null;
    const places = this.buffers.words(TEXTURE_WIDTH * textureLines(rows.length, 1));
    places.set(rows);
    for (let i = 0; i < rows.length; i++) {
      const row = rows[i];
      this.pack(frame, row);
      copy(this.base, BASE_WORDS * row, base, BASE_WORDS * i, BASE_WORDS);
      if (rest !== null) copy(this.rest, restWords * row, rest, restWords * i, restWords);
    }
    const part = { places, count: rows.length };
    return { count: this.count, part, base, rest, heat: heatOf(frame, this.buffers) };
  }

  /** Room for so many words, as long as the lines of a texture of single texels. */
  private staged(words: number): Uint32Array {
    return this.buffers.words(4 * TEXTURE_WIDTH * textureLines(words / 4, 1));
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

function copy(words: Uint32Array, from: number, to: Uint32Array, at: number, count: number): void {
  for (let i = 0; i < count; i++) to[at + i] = words[from + i];
}

function grown(words: Uint32Array, length: number): Uint32Array<ArrayBuffer> {
  const larger = new Uint32Array(length);
  larger.set(words);
  return larger;
}
