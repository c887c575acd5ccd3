/** Where a scene stands in the room of somebody with a headset: metres of the room become units of the scene. */
import type { Pose } from "../geometry/poses";
import { applied, cross, dot, length, minus, plus, times, transposed, turnAbout, unit, type Matrix, type Vector } from "../geometry/vectors";

/** How far from the middle of the scene a rig's cameras stand in the room, in metres. */
const RIG_METRES = 2.5;
/** Two hands make a scene at most so many times as large or as small as it was. */
const LARGEST = 20;

/** A hand before and after it moved, in the room. */
export interface Hand {
  readonly before: Vector;
  readonly after: Vector;
}

export class Placement {
  private origin: Vector;
  /** The room's x (right), y (up) and z (back), in the scene. */
  private axes: Matrix;
  private readonly first: number;

  /** Whoever looks from `head` in the room sees what `pose` sees in the scene, level. `size`: that of the rig. */
  constructor(pose: Pose, up: Vector, size: number, head: { readonly at: Vector; readonly back: Vector }) {
    const ahead = levelled(pose.axes[2], up) ?? levelled(pose.axes[1], up)!;
    const right = cross(ahead, up);
    this.axes = [right, up, times(ahead, -1)];
    // The head may be turned in its room.
    const turn = Math.atan2(head.back[0], head.back[2]);
    this.axes = [this.toScene([Math.cos(turn), 0, Math.sin(turn)]), up, this.toScene([-Math.sin(turn), 0, Math.cos(turn)])];
    this.scale = this.first = size / RIG_METRES;
    this.origin = minus(pose.centre, times(this.toScene(head.at), this.scale));
  }

  /** Units of the scene in a metre. */
  scale: number;

  point(at: Vector): Vector {
    return plus(this.origin, times(this.toScene(at), this.scale));
  }

  direction(way: Vector): Vector {
    return this.toScene(way);
  }

  /** One hand takes the scene along. */
  drag({ before, after }: Hand): void {
    this.origin = minus(this.origin, times(this.toScene(minus(after, before)), this.scale));
  }

  /** Two hands take it along, turn it about the vertical, and make it larger or smaller: what they hold stays in them. */
  pinch(one: Hand, other: Hand): void {
    const [from, to] = [minus(other.before, one.before), minus(other.after, one.after)];
    if (length(from) < 0.02 || length(to) < 0.02) return;
    const middle = (a: Vector, b: Vector): Vector => times(plus(a, b), 0.5);
    const held = this.point(middle(one.before, other.before));
    const ratio = length(from) / length(to);
    this.scale = Math.min(this.first * LARGEST, Math.max(this.first / LARGEST, this.scale * ratio));
    const turn = Math.atan2(to[0], to[2]) - Math.atan2(from[0], from[2]);
    const back = turnAbout(this.axes[1], -turn);
    this.axes = [applied(back, this.axes[0]), this.axes[1], applied(back, this.axes[2])];
    this.origin = minus(held, times(this.toScene(middle(one.after, other.after)), this.scale));
  }

  private toScene(way: Vector): Vector {
    return applied(transposed(this.axes), way);
  }
}

/** A direction without its part along up; null where nothing is left. */
function levelled(way: Vector, up: Vector): Vector | null {
  const flat = minus(way, times(up, dot(way, up)));
  return length(flat) > 0.1 ? unit(flat) : null;
}
