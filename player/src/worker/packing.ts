/**
 * Gaussians as words of the data textures: 32 bytes each, and 16 a texel for the harmonics above degree 0.
 *
 * | word | low half | high half |
 * |---|---|---|
 * | 0 to 2 | mean x, y, z, float32 | |
 * | 3 | red of degree 0, half | green |
 * | 4 | blue | opacity, 16 bits of 0..1 |
 * | 5 | log-scale 0, 16 bits of -40..40 | log-scale 1 |
 * | 6 | log-scale 2 | rotation, first of the smaller three |
 * | 7 | second | third |
 *
 * A rotation's largest component is made positive and left out; each of the others has 15 bits of -1/sqrt(2)..1/sqrt(2),
 * and the top bits of the second and third say which one is left out. Against float32 textures the pictures differ by
 * less than their last bit (tests/browser), for half the bytes to send.
 */
import { BATCH } from "../kernel/batch";
import { kernelInstance } from "../kernel/module";
import type { Gaussians } from "../scene";
import type { TextureLayout } from "../messages";

export const BASE_WORDS = 8;

export function textureLayout(shDegree: number): TextureLayout {
  const halves = 3 * ((shDegree + 1) ** 2 - 1);
  return { shDegree, restTexels: Math.ceil(halves / 8) };
}

type Value = "means" | "logScales" | "quaternions" | "opacityLogits" | "sh";

interface Exports {
  readonly memory: WebAssembly.Memory;
  means_at(): number;
  log_scales_at(): number;
  quaternions_at(): number;
  opacity_logits_at(): number;
  sh_at(): number;
  base_at(): number;
  rest_at(): number;
  pack(rows: number, coefficients: number, restWords: number): void;
}

/** Numbers of a kind that each Gaussian has, and where the kernel takes those of a batch. */
interface Kind {
  readonly name: Value;
  readonly each: number;
  readonly batch: Float32Array;
}

export class Packer {
  private readonly kernel: Exports;
  private readonly kinds: readonly Kind[];
  private readonly base: Uint32Array;
  private readonly rest: Uint32Array;
  private readonly coefficients: number;
  private readonly restWords: number;

  constructor({ shDegree, restTexels }: TextureLayout) {
    this.kernel = kernelInstance() as unknown as Exports;
    this.coefficients = (shDegree + 1) ** 2;
    this.restWords = 4 * restTexels;
    const { kernel } = this;
    const { buffer } = kernel.memory;
    const kind = (name: Value, each: number, at: number): Kind => {
      return { name, each, batch: new Float32Array(buffer, at, each * BATCH) };
    };
    this.kinds = [
      kind("means", 3, kernel.means_at()),
      kind("logScales", 3, kernel.log_scales_at()),
      kind("quaternions", 4, kernel.quaternions_at()),
      kind("opacityLogits", 1, kernel.opacity_logits_at()),
      kind("sh", 3 * this.coefficients, kernel.sh_at()),
    ];
    this.base = new Uint32Array(buffer, kernel.base_at(), BASE_WORDS * BATCH);
    this.rest = new Uint32Array(buffer, kernel.rest_at(), this.restWords * BATCH);
  }

  /** Writes the words of all Gaussians, or of those at some slots, one after the other; `rest` null: no harmonics. */
  pack(gaussians: Gaussians, slots: Uint32Array | null, base: Uint32Array, rest: Uint32Array | null): void {
    const all = slots?.length ?? gaussians.count;
    for (let from = 0; from < all; from += BATCH) {
      const rows = Math.min(BATCH, all - from);
      for (const { name, each, batch } of this.kinds) {
        const values = gaussians[name];
        if (slots === null) batch.set(values.subarray(each * from, each * (from + rows)));
        else gather(values, each, slots, from, rows, batch);
      }
      this.kernel.pack(rows, this.coefficients, this.restWords);
      base.set(this.base.subarray(0, BASE_WORDS * rows), BASE_WORDS * from);
      rest?.set(this.rest.subarray(0, this.restWords * rows), this.restWords * from);
    }
  }
}

function gather(values: Float32Array, each: number, slots: Uint32Array, from: number, rows: number, to: Float32Array): void {
  for (let i = 0, at = 0; i < rows; i++) {
    const start = Math.imul(slots[from + i], each);
    for (let number = 0; number < each; number++) to[at++] = values[start + number];
  }
}
