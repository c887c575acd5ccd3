/** A box or sphere drawn over the picture, as `decogs-edit crop` takes it. */
import type { PinholeCamera } from "../geometry/camera";
import { poseOf } from "../geometry/poses";
import { applied, dot, length, minus, plus, times, transposed, type Vector } from "../geometry/vectors";

/** Pixels of the camera's picture. */
export type Point = readonly [number, number];

export type Region =
  | { readonly kind: "box"; readonly low: Vector; readonly high: Vector }
  | { readonly kind: "sphere"; readonly centre: Vector; readonly radius: number };

const AXES = [0, 1, 2] as const;
const MERIDIANS = 4;
const STEPS = 32;

/**
 * What was drawn from one point to another in a camera's picture, as far away as `around` lies. A sphere lies about the first
 * point. A box has the world's axes; along the one that goes into the picture it keeps what it had, or is as deep as it is wide.
 */
export function drawnRegion(kind: Region["kind"], camera: PinholeCamera, around: Vector, from: Point, to: Point, before: Region | null): Region {
  const { axes, centre } = poseOf(camera);
  const middle = before === null ? around : middleOf(before);
  const depth = dot(axes[2], minus(middle, centre));
  const pointAt = ([x, y]: Point): Vector => {
    const seen: Vector = [((x - camera.cx) / camera.fx) * depth, ((y - camera.cy) / camera.fy) * depth, depth];
    return plus(centre, applied(transposed(axes), seen));
  };
  if (kind === "sphere") {
    const at = pointAt(from);
    return { kind, centre: at, radius: length(minus(pointAt(to), at)) };
  }
  const corners = [from, to, [from[0], to[1]] as const, [to[0], from[1]] as const].map(pointAt);
  const low = AXES.map((axis) => Math.min(...corners.map((corner) => corner[axis])));
  const high = AXES.map((axis) => Math.max(...corners.map((corner) => corner[axis])));
  const into = AXES.reduce((most, axis) => (Math.abs(axes[2][axis]) > Math.abs(axes[2][most]) ? axis : most));
  if (before?.kind === "box") [low[into], high[into]] = [before.low[into], before.high[into]];
  else {
    const half = Math.max(...AXES.filter((axis) => axis !== into).map((axis) => high[axis] - low[axis])) / 2;
    [low[into], high[into]] = [middle[into] - half, middle[into] + half];
  }
  return { kind, low: low as unknown as Vector, high: high as unknown as Vector };
}

/** The command that keeps what lies in it. */
export function cropCommand(region: Region, stream: string): string {
  const size = region.kind === "box" ? length(minus(region.high, region.low)) : region.radius;
  const digits = Math.max(0, 3 - Math.ceil(Math.log10(Math.max(size, 1e-9))));
  const number = (value: number): string => String(Number(value.toFixed(Math.min(digits, 12))));
  const vector = (values: Vector): string => values.map(number).join(",");
  const shape = region.kind === "box" ? `box ${vector(region.low)} ${vector(region.high)}` : `sphere ${vector(region.centre)} ${number(region.radius)}`;
  const name = /^[\w./-]+$/.test(stream) ? stream : `'${stream.replaceAll("'", String.raw`'\''`)}'`;
  return `decogs-edit ${name} -o cropped.dgs crop ${shape}`;
}

/** Its edges, or circles of it, in a camera's picture, as far as they lie before it. */
export function outlines(region: Region, camera: PinholeCamera): Point[][] {
  const lines = region.kind === "box" ? edges(region.low, region.high) : circles(region.centre, region.radius);
  return lines.map((line) => line.flatMap((point) => seen(point, camera)));
}

function seen(point: Vector, camera: PinholeCamera): Point[] {
  const [x, y, z] = camera.worldToCamera.map((row) => dot(row as unknown as Vector, point) + row[3]) as [number, number, number];
  return z > 1e-6 ? [[(x / z) * camera.fx + camera.cx, (y / z) * camera.fy + camera.cy]] : [];
}

function middleOf(region: Region): Vector {
  return region.kind === "sphere" ? region.centre : times(plus(region.low, region.high), 0.5);
}

function edges(low: Vector, high: Vector): Vector[][] {
  const corner = (bits: number): Vector => AXES.map((axis) => ((bits >> axis) & 1 ? high : low)[axis]) as unknown as Vector;
  const all = Array.from({ length: 8 }, (_, bits) => bits);
  return AXES.flatMap((axis) => all.filter((bits) => !((bits >> axis) & 1)).map((bits) => [corner(bits), corner(bits | (1 << axis))]));
}

function circles(centre: Vector, radius: number): Vector[][] {
  const round = Array.from({ length: STEPS + 1 }, (_, step) => (2 * Math.PI * step) / STEPS);
  const meridians = Array.from({ length: MERIDIANS }, (_, k) => (Math.PI * k) / MERIDIANS);
  const circle = (along: (angle: number) => Vector): Vector[] => round.map((angle) => plus(centre, times(along(angle), radius)));
  return [
    circle((angle) => [Math.cos(angle), 0, Math.sin(angle)]),
    ...meridians.map((turn) => circle((angle) => [Math.sin(angle) * Math.cos(turn), Math.cos(angle), Math.sin(angle) * Math.sin(turn)])),
  ];
}
