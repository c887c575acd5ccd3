/** The cameras of the rig: which one is looked through, and where the first picture is taken from. */
import { extentOf, lookedAt } from "../camera/looked_at";
import type { Navigation } from "../camera/navigation";
import { RigRange } from "../camera/rig_range";
import { upOf } from "../camera/up_direction";
import { lensOf, poseOf } from "../geometry/poses";
import { length, minus } from "../geometry/vectors";
import type { RigCamera, StreamHeader } from "../scene";

export class RigCameras {
  #index = -1;

  constructor(
    private readonly header: StreamHeader,
    private readonly navigation: Navigation,
  ) {
    const { cameras } = header;
    const poses = cameras.map(poseOf);
    navigation.up = upOf(cameras);
    navigation.pivot = lookedAt(poses);
    const centres = poses.map(({ centre }) => centre);
    const distances = centres.map((centre) => length(minus(centre, navigation.pivot))).sort((a, b) => a - b);
    navigation.range = new RigRange(poses, navigation.pivot, navigation.up);
    navigation.size = distances[distances.length >> 1] || extentOf(centres) || 1;
  }

  /** The one that is looked through; null for a free view. */
  get current(): RigCamera | null {
    return this.navigation.moved ? null : (this.header.cameras[this.#index] ?? null);
  }

  /** The place of a camera; -1 where there is none of that name. */
  named(name: string | null): number {
    return this.header.cameras.findIndex((camera) => camera.name === name);
  }

  /** The one that the stream wants to begin with, or the first that was not held out. */
  get first(): number {
    const { cameras, heldOut, presentation } = this.header;
    const { firstView } = presentation;
    return Math.max(0, cameras.findIndex(({ name }) => (firstView === null ? !heldOut.includes(name) : name === firstView)));
  }

  /** Whether there is such a camera. */
  lookThrough(index: number, atOnce: boolean): boolean {
    const camera = this.header.cameras[index] as RigCamera | undefined;
    if (camera === undefined) return false;
    this.#index = index;
    this.navigation.goTo(poseOf(camera), lensOf(camera), atOnce);
    return true;
  }

  /** The place of the camera before or after the one looked through last. */
  next(step: 1 | -1): number {
    const { length: count } = this.header.cameras;
    return (this.#index + step + count) % count;
  }

  /** Back to the camera looked through last, circling what the rig looks at. */
  back(): boolean {
    this.navigation.pivot = lookedAt(this.header.cameras.map(poseOf));
    return this.lookThrough(this.#index, false);
  }
}
