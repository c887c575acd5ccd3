/**
 * The order of Gaussians by depth, nearest first: a counting sort in 65 536 bins, linear in the number of Gaussians
 * (depth_order.c).
 *
 * Bins are the upper bits of the depths' own float32 representation above that of the nearest: a float's bits rise with it,
 * so that bins are fine nearby and coarse far away, and one Gaussian at the horizon does not take the resolution of all
 * others. Equal bins keep the order of rows, as in the decoder's kernel.
 */
import { BATCH } from "../kernel/batch";
import { kernelInstance } from "../kernel/module";
import type { DepthRow } from "../messages";

interface Exports {
  readonly memory: WebAssembly.Memory;
  sort_means_at(): number;
  sort_order_at(): number;
  sort_reserve(count: number): number;
  sort_begin(): void;
  sort_depths(from: number, count: number, x: number, y: number, z: number, offset: number): void;
  sort_rows(count: number): number;
}

/** An instance of the kernel with room for so many rows. */
class Room {
  readonly kernel = kernelInstance() as unknown as Exports;
  readonly means: Float32Array;
  readonly order: Uint32Array;

  constructor(readonly capacity: number) {
    const { kernel } = this;
    if (kernel.sort_reserve(capacity) === 0) throw new RangeError(`no memory to sort ${capacity} Gaussians`);
    const { buffer } = kernel.memory;
    this.means = new Float32Array(buffer, kernel.sort_means_at(), 3 * BATCH);
    this.order = new Uint32Array(buffer, kernel.sort_order_at(), capacity);
  }
}

export class DepthSorter {
  private room: Room | null = null;

  /** Writes the rows before the camera to `order` and returns how many these are. */
  sort(means: Float32Array, count: number, [x, y, z, offset]: DepthRow, order: Uint32Array): number {
    if (this.room === null || this.room.capacity < count) this.room = new Room(Math.ceil(count * 1.25));
    const { kernel, means: batch, order: sorted } = this.room;
    kernel.sort_begin();
    for (let from = 0; from < count; from += BATCH) {
      const rows = Math.min(BATCH, count - from);
      batch.set(means.subarray(3 * from, 3 * (from + rows)));
      kernel.sort_depths(from, rows, x, y, z, offset);
    }
    const drawn = kernel.sort_rows(count);
    order.set(sorted.subarray(0, drawn));
    return drawn;
  }
}
