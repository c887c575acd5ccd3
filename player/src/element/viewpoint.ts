/** From where the stream is looked at: a camera of its rig or any other view, also one that was asked for before it came. */
import type { Fence } from "../camera/fence";
import type { Navigation } from "../camera/navigation";
import type { Lens } from "../geometry/camera";
import type { Pose } from "../geometry/poses";
import { length, type Vector } from "../geometry/vectors";
import type { View } from "../player_api";
import type { RigCamera, StreamHeader } from "../scene";
import { RigCameras } from "./rig_cameras";

export interface ViewpointHost {
  readonly navigation: () => Navigation | null;
  /** Another picture is to be drawn. */
  readonly moved: () => void;
  /** A camera of the rig is looked through. */
  readonly put: () => void;
  /** Somebody wants to see the scene from elsewhere. */
  readonly asked: () => void;
}

export class Viewpoint {
  #cameras: RigCameras | null = null;
  /** What to look at when the next stream has come. */
  #startView: View | null = null;
  #startCamera = "";
  #fence: Fence | null = null;

  constructor(private readonly host: ViewpointHost) {}

  /** The camera that is looked through; null for a free view. */
  get camera(): RigCamera | null {
    return this.#cameras?.current ?? null;
  }

  get view(): View | null {
    const navigation = this.#cameras === null ? null : this.host.navigation();
    return navigation && { pose: navigation.pose, lens: navigation.lens };
  }

  get isFlying(): boolean {
    return length(this.host.navigation()?.flight ?? [0, 0, 0]) > 0;
  }

  /** Whether the view moves by itself. */
  get isMoving(): boolean {
    return this.isFlying || this.host.navigation()?.isSwaying === true;
  }

  close(): void {
    this.#cameras = null;
  }

  /** A stream has come: looks through the camera that was asked for, or the first; a view that was asked for comes before both. */
  open(header: StreamHeader, navigation: Navigation, camera: string | null, view: View | null): void {
    const cameras = new RigCameras(header, navigation);
    this.#cameras = cameras;
    const named = cameras.named(this.#startCamera || camera);
    cameras.lookThrough(named >= 0 ? named : cameras.first, true);
    this.#put();
    const start = this.#startView ?? view;
    if (start !== null) this.lookFrom(start.pose, start.lens);
    this.#startView = null;
    this.#startCamera = "";
  }

  lookAt(camera: string): void {
    if (this.#cameras === null) this.#startCamera = camera;
    const index = this.#cameras?.named(camera) ?? -1;
    if (index >= 0) this.lookThrough(index);
  }

  lookThrough(index: number, atOnce = false): void {
    if (this.#cameras?.lookThrough(index, atOnce) === true) this.#put();
    this.host.asked();
  }

  next(step: 1 | -1): void {
    if (this.#cameras !== null) this.lookThrough(this.#cameras.next(step));
  }

  back(): void {
    if (this.#cameras?.back() === true) this.#put();
    this.host.asked();
  }

  lookFrom(pose: Pose, lens: Lens): void {
    const navigation = this.host.navigation();
    if (this.#cameras === null || navigation === null) this.#startView = { pose, lens };
    else {
      navigation.goTo(pose, lens, true);
      navigation.moved = true;
      this.moved();
    }
  }

  fly(direction: Vector): void {
    const navigation = this.host.navigation();
    if (navigation === null) return;
    navigation.flight = direction;
    this.moved();
  }

  /** Has the view move by itself until somebody takes it. */
  sway(on: boolean): void {
    this.host.navigation()?.sway(on);
    if (this.isMoving) this.host.asked();
  }

  /** Keeps views where the rig's cameras have seen the scene from, or within the fence if there is one. */
  limit(on: boolean): void {
    const navigation = this.host.navigation();
    if (navigation !== null) Object.assign(navigation, { limited: on, fence: this.#fence });
  }

  set fence(fence: Fence | null) {
    this.#fence = fence;
    const navigation = this.host.navigation();
    if (navigation !== null) navigation.fence = fence;
  }

  /** Somebody moved the view. */
  moved(): void {
    this.host.asked();
    this.host.moved();
  }

  #put(): void {
    this.host.moved();
    this.host.put();
  }
}
