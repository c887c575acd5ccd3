/** What draws a scene: WebGL2 here, the decoder's own kernel elsewhere. The element knows no more of either. */
import type { PinholeCamera } from "../geometry/camera";
import type { DrawOrder, SceneUpdate, TextureLayout } from "../messages";
import type { Overlay } from "../player_api";
import type { StreamHeader } from "../scene";

export interface DrawTimes {
  /** Of the frame's textures; of the order; until the picture was there, as far as that can be known. */
  uploadMs: number;
  drawMs: number;
}

/** Where a picture goes that is not for the canvas: its lower left corner in a framebuffer. */
export interface Target {
  readonly framebuffer: WebGLFramebuffer | null;
  readonly x: number;
  readonly y: number;
  /** Whether nothing is to lie behind the scene. */
  readonly clear: boolean;
}

export interface Renderer {
  /** Where pictures appear; `draw` gives it the camera's size. */
  readonly canvas: HTMLCanvasElement;
  readonly times: DrawTimes;
  /** Whether the last picture asked for is not finished yet: another one would only queue up behind it. */
  readonly busy: boolean;
  /** Whether the browser says that the processor draws, not a graphics card. */
  readonly inSoftware?: boolean;
  /** Begins a stream: what was loaded is forgotten. A subject is drawn over nothing. */
  begin(layout: TextureLayout, header: StreamHeader): void;
  load(update: SceneUpdate): void;
  order(draw: DrawOrder): void;
  /** `quick`: what many faint Gaussians add may be rounded away. */
  draw(camera: PinholeCamera, overlay: Overlay, quick: boolean): void;
  /** Resolves when the picture asked for last is in the canvas, where that takes longer than `draw`. */
  settled?(): Promise<void>;
  dispose(): void;
}
