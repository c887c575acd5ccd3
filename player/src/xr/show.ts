/** A scene in a headset (WebXR): a picture for each eye, sorted for the point between them, and hands that place the scene. */
import type { Target } from "../draw/renderer";
import type { PinholeCamera } from "../geometry/camera";
import type { Pose } from "../geometry/poses";
import type { Vector } from "../geometry/vectors";
import type { DepthRow } from "../messages";
import { backOf, cameraOf, positionOf, standing } from "./eye";
import { Placement, type Hand } from "./placement";

export type XrMode = "immersive-vr" | "immersive-ar";

/** What a headset needs of the player. */
export interface ShowHost {
  readonly gl: WebGL2RenderingContext;
  readonly pose: Pose;
  readonly up: Vector;
  /** How far the rig stands from what it looks at. */
  readonly size: number;
  readonly draw: (camera: PinholeCamera, target: Target) => void;
  readonly sort: (depth: DepthRow) => void;
  readonly advance: (seconds: number) => void;
  readonly playOrPause: () => void;
  readonly ended: () => void;
}

export class Show {
  private placement: Placement | null = null;
  private lastTime = 0;
  /** Hands that hold the scene, and where they were. */
  private readonly held = new Map<XRInputSource, Vector | null>();

  private constructor(
    private readonly session: XRSession,
    private readonly space: XRReferenceSpace,
    private readonly mode: XrMode,
    private readonly host: ShowHost,
  ) {
    session.addEventListener("end", () => {
      host.ended();
    });
    session.addEventListener("squeezestart", ({ inputSource }) => this.held.set(inputSource, null));
    session.addEventListener("squeezeend", ({ inputSource }) => this.held.delete(inputSource));
    session.addEventListener("select", () => {
      host.playOrPause();
    });
    session.requestAnimationFrame(this.tick);
  }

  /** To be called while a click is handled. Rejects where there is no headset, or somebody refuses. */
  static async begin(mode: XrMode, host: ShowHost): Promise<Show> {
    if (navigator.xr === undefined) throw new Error("this browser shows nothing in headsets (WebXR)");
    const session = await navigator.xr.requestSession(mode, { optionalFeatures: ["local-floor", "hand-tracking"] });
    try {
      await host.gl.makeXRCompatible();
      await session.updateRenderState({ baseLayer: new XRWebGLLayer(session, host.gl, { antialias: false, depth: false, stencil: false }) });
      return new Show(session, await session.requestReferenceSpace("local"), mode, host);
    } catch (error) {
      await session.end();
      throw error;
    }
  }

  async end(): Promise<void> {
    await this.session.end();
  }

  private readonly tick = (time: number, frame: XRFrame): void => {
    this.session.requestAnimationFrame(this.tick);
    const seen = frame.getViewerPose(this.space);
    const layer = this.session.renderState.baseLayer;
    if (seen === undefined || layer === undefined) return;
    const { host } = this;
    host.advance(this.lastTime === 0 ? 0 : Math.min(0.1, (time - this.lastTime) / 1000));
    this.lastTime = time;
    const { matrix: head } = seen.transform;
    this.placement ??= new Placement(host.pose, host.up, host.size, { at: positionOf(head), back: backOf(head) });
    this.moveByHand(frame, this.placement);
    host.sort(standing(head, this.placement)[2]);
    for (const view of seen.views) {
      const viewport = layer.getViewport(view);
      if (viewport === undefined || viewport.width === 0) continue;
      const { x, y, width, height } = viewport;
      const eye = { matrix: view.transform.matrix, projection: view.projectionMatrix, width, height };
      host.draw(cameraOf(eye, this.placement), { framebuffer: layer.framebuffer, x, y, clear: this.mode === "immersive-ar" });
    }
  };

  private moveByHand(frame: XRFrame, placement: Placement): void {
    const hands: Hand[] = [];
    for (const [source, before] of this.held) {
      const matrix = frame.getPose(source.gripSpace ?? source.targetRaySpace, this.space)?.transform.matrix;
      if (matrix === undefined) continue;
      const after = positionOf(matrix);
      this.held.set(source, after);
      if (before !== null) hands.push({ before, after });
    }
    if (hands.length === 1) placement.drag(hands[0]);
    else if (hands.length > 1) placement.pinch(hands[0], hands[1]);
  }
}
