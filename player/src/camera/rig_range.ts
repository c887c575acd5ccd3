/**
 * Where a rig's cameras stand about what they look at: what may be looked at from where, and how far a view sways by itself.
 * Angles are those of a compass about the pivot, and heights above its horizon.
 */
import type { Pose } from "../geometry/poses";
import { cross, dot, length, minus, unit, type Vector } from "../geometry/vectors";

/** Radians beyond the outermost cameras, and shares of the nearest and farthest distance, that are still allowed. */
const MARGIN = (12 * Math.PI) / 180;
const NEAREST = 0.5;
const FARTHEST = 1.4;
/** A rig whose largest gap is below this stands all around. */
const LARGEST_GAP = (100 * Math.PI) / 180;
/** Of the way to the outermost camera, a view sways so far, within these bounds. */
const SWAY = 0.6;
const [LEAST_SWAY, MOST_SWAY] = [(4 * Math.PI) / 180, (20 * Math.PI) / 180];

interface Orbit {
  readonly around: number;
  readonly climb: number;
  readonly distance: number;
}

export class RigRange {
  /** Whether cameras stand all around. */
  readonly allAround: boolean;
  private readonly axes: readonly [Vector, Vector];
  /** The compass begins in the middle of the cameras. */
  private middle = 0;
  private readonly half: number;
  private readonly climbs: readonly [number, number];
  private readonly distances: readonly [number, number];

  constructor(
    poses: readonly Pose[],
    private readonly pivot: Vector,
    private readonly up: Vector,
  ) {
    const aside = Math.abs(up[0]) < 0.9 ? ([1, 0, 0] as const) : ([0, 1, 0] as const);
    const right = unit(cross(up, aside));
    this.axes = [right, cross(up, right)];
    const positions = poses.map(({ centre }) => this.orbitOf(centre));
    const around = positions.map((position) => position.around).sort((a, b) => a - b);
    const gaps = around.map((angle, i) => (i > 0 ? angle - around[i - 1] : angle + 2 * Math.PI - around[around.length - 1]));
    const widest = gaps.reduce((most, gap) => Math.max(most, gap));
    const behindGap = gaps.indexOf(widest);
    this.allAround = widest < LARGEST_GAP;
    this.half = Math.PI - widest / 2;
    this.middle = around[behindGap] + this.half;
    const climbs = positions.map(({ climb }) => climb);
    this.climbs = [Math.min(...climbs), Math.max(...climbs)];
    const distances = positions.map(({ distance }) => distance);
    this.distances = [NEAREST * Math.min(...distances), FARTHEST * Math.max(...distances)];
  }

  /** How far a place lies outside of what is allowed; 0 inside. */
  outside(centre: Vector): number {
    const { around, distance } = this.orbitOf(centre);
    const aside = this.allAround ? 0 : beyond(Math.abs(turned(around - this.middle)), 0, this.half + MARGIN);
    return aside + this.above(centre) + beyond(distance, ...this.distances) / this.distances[1];
  }

  /** How far a place lies above or below all cameras; 0 between. */
  above(centre: Vector): number {
    return beyond(this.orbitOf(centre).climb, this.climbs[0] - MARGIN, this.climbs[1] + MARGIN);
  }

  /** Radians to either side that a view from there may sway. */
  sway(centre: Vector): number {
    const room = this.allAround ? MOST_SWAY : this.half - Math.abs(turned(this.orbitOf(centre).around - this.middle));
    return Math.min(MOST_SWAY, Math.max(LEAST_SWAY, SWAY * room));
  }

  private orbitOf(centre: Vector): Orbit {
    const from = minus(centre, this.pivot);
    const distance = length(from) || 1;
    const around = Math.atan2(dot(from, this.axes[1]), dot(from, this.axes[0]));
    return { around, climb: Math.asin(Math.min(1, Math.max(-1, dot(from, this.up) / distance))), distance };
  }
}

function beyond(value: number, low: number, high: number): number {
  return Math.max(0, low - value, value - high);
}

/** An angle between -pi and pi. */
function turned(angle: number): number {
  return Math.atan2(Math.sin(angle), Math.cos(angle));
}
