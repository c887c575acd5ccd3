/**
 * The camera that a person moves: it circles a pivot, shifts, flies, and jumps to cameras of the rig.
 *
 * A camera of the rig is shown as it stands, tilted if it is; as soon as one circles the pivot the horizon levels.
 * Movements glide to rest. `step` is called once a picture.
 */
import type { Lens } from "../geometry/camera";
import type { Pose } from "../geometry/poses";
import { lookingAxes } from "../geometry/poses";
import type { Fence } from "./fence";
import type { RigRange } from "./rig_range";
import {
  applied,
  cross,
  dot,
  length,
  minus,
  plus,
  product,
  times,
  transposed,
  turnAbout,
  unit,
  type Matrix,
  type Vector,
} from "../geometry/vectors";

/** Radians that always stay between the view and straight up or down. */
const POLE = 0.05;
/** Seconds in which a gliding movement falls to a third. */
const GLIDE = 0.09;
const JUMP_SECONDS = 0.45;
const LEVELLING = 6;
const STILL = 1e-4;
/** Of a round, or once to and fro. */
const SWAY_SECONDS = 24;
/** Distances from the pivot that zooming ends at, in those of the rig. */
const NEAREST = 0.01;
const FARTHEST = 8;

interface Jump {
  readonly from: Pose;
  readonly to: Pose;
  readonly fromLens: Lens;
  readonly toLens: Lens;
  done: number;
}

export class Navigation {
  pose: Pose = {
    axes: [
      [1, 0, 0],
      [0, 1, 0],
      [0, 0, 1],
    ],
    centre: [0, 0, 0],
  };
  lens: Lens = { width: 640, height: 360, fx: 500, fy: 500, cx: 320, cy: 180, near: 0 };
  up: Vector = [0, -1, 0];
  pivot: Vector = [0, 0, 1];
  /** Distances are told in this: how far the rig stands from what it looks at. */
  size = 1;
  /** Whether the person has moved away from where the camera was put. */
  moved = false;
  /** Directions of flight from -1 to 1: right, up, forward. */
  flight: Vector = [0, 0, 0];
  /** Whether jumps and glides are left out. */
  calm = false;
  /** Where cameras stand; null before it is known. */
  range: RigRange | null = null;
  /** Whether views stay where the cameras of the rig have seen the scene from. */
  limited = false;
  /** Where views stay instead, seen from above, if a fence is known. */
  fence: Fence | null = null;

  private spin: [number, number] = [0, 0];
  private shift: Vector = [0, 0, 0];
  private approach = 0;
  private velocity: Vector = [0, 0, 0];
  private jump: Jump | null = null;
  private levelling = false;
  /** A view that moves by itself, until somebody takes it. */
  private swaying: { readonly from: Pose; seconds: number } | null = null;

  /** Whether the camera is on its way to where it was put. */
  get jumping(): boolean {
    return this.jump !== null;
  }

  /** Puts the camera somewhere, at once or by a short flight. */
  goTo(pose: Pose, lens: Lens, atOnce: boolean): void {
    this.rest();
    this.swaying = null;
    this.moved = false;
    if (atOnce || this.calm) {
      [this.pose, this.lens, this.jump] = [pose, lens, null];
      return;
    }
    this.jump = { from: this.pose, to: pose, fromLens: this.lens, toLens: lens, done: 0 };
  }

  /** Moves to and fro about the pivot, or around it where cameras stand all around, until somebody moves the camera. */
  sway(on: boolean): void {
    this.swaying = on && !this.calm && this.range !== null ? { from: this.pose, seconds: 0 } : null;
    if (this.swaying !== null) this.moved = true;
  }

  get isSwaying(): boolean {
    return this.swaying !== null;
  }

  /** Circles the pivot, by radians to the right and down. */
  orbit(right: number, down: number): void {
    this.begin();
    this.levelling = true;
    this.spin = [this.spin[0] + right, this.spin[1] + down];
    if (this.calm) this.glide(1);
  }

  /** Turns the camera where it stands. */
  look(right: number, down: number): void {
    this.begin();
    this.levelling = true;
    const { centre, axes } = this.pose;
    const turned = this.turned(axes, right, down);
    this.pose = { axes: turned, centre };
    const distance = length(minus(this.pivot, centre));
    this.pivot = plus(centre, times(turned[2], distance));
  }

  /** Shifts the picture by pixels of the lens. */
  pan(right: number, down: number): void {
    this.begin();
    const { axes, centre } = this.pose;
    const depth = Math.max(dot(axes[2], minus(this.pivot, centre)), 0.05 * this.size);
    const across = times(axes[0], (-right * depth) / this.lens.fx);
    const along = times(axes[1], (-down * depth) / this.lens.fy);
    this.shift = plus(this.shift, plus(across, along));
    if (this.calm) this.glide(1);
  }

  /** Goes nearer to the pivot (below 1) or away from it, by a factor of the distance. */
  zoom(factor: number): void {
    this.begin();
    const distance = length(minus(this.pose.centre, this.pivot));
    const [nearest, farthest] = [Math.min(distance, NEAREST * this.size), Math.max(distance, FARTHEST * this.size)];
    this.approach = clamped(this.approach + Math.log(factor), Math.log(nearest / distance), Math.log(farthest / distance));
    if (this.calm) this.glide(1);
  }

  /** Moves on by some seconds; whether the view has changed. */
  step(seconds: number): boolean {
    const before = this.pose;
    if (length(this.flight) > 0) this.begin();
    if (this.swaying !== null) this.swayOn(this.swaying, seconds);
    else if (this.jump !== null) this.fly(this.jump, seconds);
    else {
      this.glide(this.calm ? 1 : 1 - Math.exp(-seconds / GLIDE));
      this.travel(seconds);
    }
    if (this.limited && this.jump === null) this.holdWithin(before);
    return this.pose !== before;
  }

  /** A wall around what the cameras see from, or the fence: no farther out; who is outside may come back. */
  private holdWithin(before: Pose): void {
    const { range, fence, pose } = this;
    if (range === null || pose === before || !this.moved) return;
    const outside = ({ centre }: Pose): number => (fence === null ? range.outside(centre) : fence.outside(centre) + range.above(centre));
    const now = outside(pose);
    if (now > 0 && now > outside(before)) {
      this.pose = before;
      this.rest();
    }
  }

  private swayOn(swaying: { readonly from: Pose; seconds: number }, seconds: number): void {
    const { from } = swaying;
    swaying.seconds += seconds;
    const round = (2 * Math.PI * swaying.seconds) / SWAY_SECONDS;
    const angle = this.range!.allAround ? round : this.range!.sway(from.centre) * Math.sin(round);
    const turn = turnAbout(this.up, angle);
    const away = applied(turn, minus(from.centre, this.pivot));
    this.pose = { axes: product(from.axes, transposed(turn)), centre: plus(this.pivot, away) };
  }

  private begin(): void {
    this.swaying = null;
    this.jump = null;
    this.moved = true;
  }

  private rest(): void {
    this.spin = [0, 0];
    this.shift = this.velocity = [0, 0, 0];
    this.approach = 0;
    this.levelling = false;
  }

  /** Carries out a share of the movements that are due. */
  private glide(share: number): void {
    const { spin, shift, approach } = this;
    const still = Math.abs(spin[0]) + Math.abs(spin[1]) + Math.abs(approach) + length(shift) / this.size < STILL;
    if (still) {
      this.spin = [0, 0];
      this.shift = [0, 0, 0];
      this.approach = 0;
      return;
    }
    const rest = 1 - share;
    this.circle(spin[0] * share, spin[1] * share, share);
    const away = times(minus(this.pose.centre, this.pivot), Math.exp(approach * share));
    const shifted = times(shift, share);
    this.pivot = plus(this.pivot, shifted);
    this.pose = { axes: this.pose.axes, centre: plus(this.pivot, away) };
    this.spin = [spin[0] * rest, spin[1] * rest];
    this.shift = times(shift, rest);
    this.approach = approach * rest;
  }

  private circle(right: number, down: number, share: number): void {
    const { axes, centre } = this.pose;
    const turned = this.turned(axes, right, down, share);
    // The pivot stays where it is in the picture: the same camera coordinates, the other axes.
    const inCamera = applied(axes, minus(this.pivot, centre));
    this.pose = { axes: turned, centre: minus(this.pivot, applied(transposed(turned), inCamera)) };
  }

  /** Axes turned about up and about the camera's own right, not over the poles, and a share more level. */
  private turned(axes: Matrix, right: number, down: number, share = 0.3): Matrix {
    const climb = Math.asin(clamped(dot(axes[2], this.up), -1, 1));
    const limit = Math.PI / 2 - POLE;
    const pitch = clamped(climb - down, Math.min(-limit, climb), Math.max(limit, climb)) - climb;
    // World directions turn by the rotation; rows are directions, so that it multiplies from the right, transposed.
    const about = product(turnAbout(this.up, -right), turnAbout(axes[0], pitch));
    const turned = product(axes, transposed(about));
    return this.levelling ? this.levelled(turned, Math.min(1, share * LEVELLING * 0.1)) : turned;
  }

  private levelled(axes: Matrix, share: number): Matrix {
    const level = lookingAxes([0, 0, 0], axes[2], this.up);
    const roll = Math.atan2(dot(axes[0], level[1]), dot(axes[0], level[0]));
    if (Math.abs(roll) < 1e-9) return axes;
    return product(axes, transposed(turnAbout(axes[2], -roll * share)));
  }

  private travel(seconds: number): void {
    const wanted = this.flight;
    if (length(wanted) === 0 && length(this.velocity) < 1e-3) {
      this.velocity = [0, 0, 0];
      return;
    }
    this.begin();
    const share = this.calm ? 1 : 1 - Math.exp(-seconds / GLIDE);
    this.velocity = plus(times(this.velocity, 1 - share), times(wanted, share));
    const { axes, centre } = this.pose;
    const [right, up, forward] = times(this.velocity, 0.6 * this.size * seconds);
    const way = plus(plus(times(axes[0], right), times(this.up, up)), times(axes[2], forward));
    this.pivot = plus(this.pivot, way);
    this.pose = { axes, centre: plus(centre, way) };
  }

  private fly(jump: Jump, seconds: number): void {
    jump.done = Math.min(1, jump.done + seconds / JUMP_SECONDS);
    if (jump.done === 1) {
      [this.pose, this.lens, this.jump] = [jump.to, jump.toLens, null];
      return;
    }
    const t = jump.done * jump.done * (3 - 2 * jump.done);
    this.pose = between(jump.from, jump.to, this.pivot, t);
    this.lens = lensBetween(jump.fromLens, jump.toLens, t);
  }
}

/** On the way from one pose to another, about the pivot: the distance to it, and the direction, change evenly. */
function between(from: Pose, to: Pose, pivot: Vector, t: number): Pose {
  const mixed = (a: Vector, b: Vector): Vector => plus(times(a, 1 - t), times(b, t));
  const forward = mixed(from.axes[2], to.axes[2]);
  const down = mixed(from.axes[1], to.axes[1]);
  const z = unit(length(forward) > 1e-3 ? forward : to.axes[2]);
  const x = unit(cross(down, z));
  const [a, b] = [minus(from.centre, pivot), minus(to.centre, pivot)];
  const chord = mixed(a, b);
  const radius = (1 - t) * length(a) + t * length(b);
  const centre = length(chord) > 0.1 * radius ? plus(pivot, times(unit(chord), radius)) : plus(pivot, chord);
  return { axes: [x, cross(z, x), z], centre };
}

function lensBetween(from: Lens, to: Lens, t: number): Lens {
  const mixed = (a: number, b: number): number => a + (b - a) * t;
  const { width, height } = to;
  const [sx, sy] = [width / from.width, height / from.height];
  return {
    width,
    height,
    fx: mixed(from.fx * sx, to.fx),
    fy: mixed(from.fy * sy, to.fy),
    cx: mixed(from.cx * sx, to.cx),
    cy: mixed(from.cy * sy, to.cy),
    near: to.near,
  };
}

function clamped(value: number, low: number, high: number): number {
  return Math.min(high, Math.max(low, value));
}
