/** Where a viewer may stand: a map from above, as `decogs-report --fence` writes it. */
import { dot, type Vector } from "../geometry/vectors";

type Place = readonly [number, number];

const MOST_CELLS = 1 << 16;

export class Fence {
  /** Middles of the admitted cells. */
  private readonly admitted: readonly Place[];
  private readonly half: Place;

  /** `axes` of the plan in the world, corners `low` and `high` on it, and which of its cells, by row and column, are `within`. */
  private constructor(
    private readonly axes: readonly [Vector, Vector],
    low: Place,
    high: Place,
    within: readonly (readonly boolean[])[],
  ) {
    const cell = (axis: 0 | 1, count: number): number => (high[axis] - low[axis]) / count;
    const [across, down] = [cell(0, within[0].length), cell(1, within.length)];
    this.half = [across / 2, down / 2];
    this.admitted = within.flatMap((row, y) => row.flatMap((inside, x) => (inside ? [[low[0] + (x + 0.5) * across, low[1] + (y + 0.5) * down] as const] : [])));
  }

  /** Throws where the document is another, or admits no place. */
  static of(document: unknown): Fence {
    const { axes, low, high, within } = (document ?? {}) as Record<string, unknown>;
    const isMap = isTable(within, 0, (cell) => typeof cell === "boolean") && within.length > 0 && within[0].length > 0 && within.length * within[0].length <= MOST_CELLS;
    if (!isMap || !isTable(axes, 3, Number.isFinite) || axes.length !== 2 || !isTable([low, high], 2, Number.isFinite)) throw new Error("a fence is what decogs-report --fence writes");
    const fence = new Fence(axes as unknown as [Vector, Vector], low as Place, high as Place, within as boolean[][]);
    if (fence.admitted.length === 0) throw new Error("the fence admits no place");
    return fence;
  }

  /** How far a place lies from the nearest that is admitted, seen from above; 0 inside. */
  outside(centre: Vector): number {
    const [x, y] = [dot(this.axes[0], centre), dot(this.axes[1], centre)];
    const beyond = (value: number, middle: number, half: number): number => Math.max(0, Math.abs(value - middle) - half);
    return Math.min(...this.admitted.map(([column, row]) => Math.hypot(beyond(x, column, this.half[0]), beyond(y, row, this.half[1]))));
  }
}

/** Whether these are rows of one length, of `width` cells if that is not 0. */
function isTable(rows: unknown, width: number, isCell: (cell: unknown) => boolean): rows is readonly (readonly unknown[])[] {
  return Array.isArray(rows) && rows.every((row: unknown) => Array.isArray(row) && row.length === (width || (rows[0] as unknown[]).length) && row.every(isCell));
}
