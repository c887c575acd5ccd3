/**
 * The order of Gaussians by depth, nearest first: a counting sort in 65 536 bins, linear in the number of Gaussians.
 *
 * Bins are the upper bits of the depths' own float32 representation above that of the nearest: a float's bits rise with it,
 * so that bins are fine nearby and coarse far away, and one Gaussian at the horizon does not take the resolution of all
 * others. Equal bins keep the order of rows, as in the decoder's kernel.
 */
import type { DepthRow } from "../messages";

const BINS = 1 << 16;

export class DepthSorter {
  private depths = new Float32Array(0);
  private bits = new Uint32Array(0);
  private readonly starts = new Uint32Array(BINS + 1);

  /** Writes the rows before the camera to `order` and returns how many these are. */
  sort(means: Float32Array, count: number, view: DepthRow, order: Uint32Array): number {
    this.reserve(count);
    const { depths, bits, starts } = this;
    const [x, y, z, offset] = view;
    let nearest = 0x7f800000;
    let farthest = 0;
    for (let row = 0, at = 0; row < count; row++, at += 3) {
      depths[row] = x * means[at] + y * means[at + 1] + z * means[at + 2] + offset;
      // Negative floats have the top bit set: as unsigned numbers they lie above every finite positive one.
      const word = bits[row];
      if (word === 0 || word >= 0x7f800000) continue;
      if (word < nearest) nearest = word;
      if (word > farthest) farthest = word;
    }
    if (farthest < nearest) return 0;
    let drop = 0;
    while ((farthest - nearest) >>> drop >= BINS) drop++;

    starts.fill(0);
    for (let row = 0; row < count; row++) {
      const word = bits[row];
      if (word >= nearest && word <= farthest) starts[((word - nearest) >>> drop) + 1]++;
    }
    for (let bin = 1; bin <= BINS; bin++) starts[bin] += starts[bin - 1];
    const drawn = starts[BINS];
    for (let row = 0; row < count; row++) {
      const word = bits[row];
      if (word >= nearest && word <= farthest) order[starts[(word - nearest) >>> drop]++] = row;
    }
    return drawn;
  }

  private reserve(count: number): void {
    if (this.depths.length >= count) return;
    this.depths = new Float32Array(Math.ceil(count * 1.25));
    this.bits = new Uint32Array(this.depths.buffer);
  }
}
