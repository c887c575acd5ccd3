/** A stream in a scene of PlayCanvas: at an entity, hidden by what is opaque before it. */
import { GAMMA_NONE, LAYERID_WORLD, Mat4, type AppBase, type CameraComponent, type Entity, type EventHandle, type Layer } from "playcanvas";
import { ScenePlayer, type SceneOptions } from "./scene_player";

export { ScenePlayer, type SceneOptions };

export interface EntityOptions extends SceneOptions {
  /** The layer behind whose transparent objects it is drawn: the world's by itself. */
  readonly layer?: number;
}

/**
 * Draws a stream where an entity stands, which may be turned, shifted and scaled (alike in all directions). `player` plays it.
 *
 * It has no light and no shadows. Orthographic cameras draw nothing of it, which `player.error` says. Throws an Error where the device is not
 * WebGL2.
 */
export class DecogsEntity {
  readonly player: ScenePlayer;
  readonly #hook: EventHandle;
  readonly #modelView = new Mat4();

  constructor(app: AppBase, entity: Entity, source: string, { layer = LAYERID_WORLD, ...options }: EntityOptions = {}) {
    const device = app.graphicsDevice as unknown as { readonly isWebGL2?: boolean; readonly gl: WebGL2RenderingContext };
    if (device.isWebGL2 !== true) throw new Error("a .dgs stream needs a WebGL2 device: create the application with DEVICETYPE_WEBGL2");
    this.player = new ScenePlayer(source, options);
    this.#hook = app.scene.on("postrender:layer", (camera: CameraComponent, drawn: Layer, transparent: boolean) => {
      if (!transparent || drawn.id !== layer || !entity.enabled) return;
      this.#modelView.mul2(camera.viewMatrix, entity.getWorldTransform());
      this.player.draw(device.gl, {
        modelView: this.#modelView.data,
        projection: camera.projectionMatrix.data,
        flipped: (camera.renderTarget as { readonly flipY: boolean } | null)?.flipY === true,
        linear: camera.gammaCorrection === GAMMA_NONE,
      });
    });
  }

  destroy(): void {
    this.#hook.off();
    this.player.dispose();
  }
}
