/** The scene of the frame shown last, packed for textures: what of it the page has to be sent. */
import type { SceneFrame } from "../scene";
import { TEXTURE_WIDTH, perLine, textureLines, type SceneUpdate, type TextureLayout } from "../messages";
import type { Buffers } from "./buffers";
import { heatOf } from "./heat";
import { BASE_WORDS, Packer } from "./packing";

/** Above this share of changed rows everything is sent: one upload of a whole texture costs less than many rows. */
const MOST_ROWS = 0.25;
/** Of rows, beyond those that are there: so that a scene which grows is not sent anew at once. */
const SPARE = 0.1;

export class PackedScene {
  private count = 0;
  private scene: SceneFrame | null = null;
  /** Rows for which the page's textures have room. */
  private room = 0;
  private readonly restWords: number;
  private readonly packer: Packer;

  constructor(
    layout: TextureLayout,
    private readonly buffers: Buffers,
  ) {
    this.restWords = 4 * layout.restTexels;
    this.packer = new Packer(layout);
  }

  /** Packs what a frame changed; what the page needs for it, null when nothing. */
  take(frame: SceneFrame): SceneUpdate | null {
    const before = this.count;
    this.count = frame.gaussians.count;
    const rows = frame.changedRows;
    const moved = frame.frame !== this.scene?.frame; // then the glow of what changed is another one
    this.scene = frame;
    if (rows === null) return this.whole();
    if (rows.length === 0 && before === this.count && !moved) return null;
    if (rows.length <= MOST_ROWS * this.count && this.count <= this.room) return this.part(frame, rows);
    return this.whole();
  }

  /** Everything, for a page that has nothing yet. */
  whole(): SceneUpdate {
    const { gaussians } = this.scene!;
    this.room = Math.ceil(this.count * (1 + SPARE));
    const base = this.lines(BASE_WORDS);
    const rest = this.restWords > 0 ? this.lines(this.restWords) : null;
    this.packer.pack(gaussians, null, base, rest);
    return { count: this.count, part: null, base, rest, heat: heatOf(this.scene!, this.buffers) };
  }

  /** Words as long as the lines of a texture that has room for all rows and some more. */
  private lines(width: number): Uint32Array {
    const texels = width / 4;
    return this.buffers.words(width * perLine(texels) * textureLines(this.room, texels));
  }

  private part(frame: SceneFrame, rows: Uint32Array): SceneUpdate {
    const base = this.staged(BASE_WORDS * rows.length);
    const rest = this.restWords > 0 ? this.staged(this.restWords * rows.length) : null;
    const slots = this.buffers.words(TEXTURE_WIDTH * textureLines(rows.length, 1));
    slots.set(rows);
    this.packer.pack(frame.gaussians, rows, base, rest);
    const part = { slots, count: rows.length };
    return { count: this.count, part, base, rest, heat: heatOf(frame, this.buffers) };
  }

  /** Room for so many words, as long as the lines of a texture of single texels. */
  private staged(words: number): Uint32Array {
    return this.buffers.words(4 * TEXTURE_WIDTH * textureLines(words / 4, 1));
  }
}
