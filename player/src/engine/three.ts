/** A stream in a scene of three.js: an object among others, hidden by what is opaque before it. */
import { Mesh, MeshBasicMaterial, BufferGeometry, SRGBColorSpace, type Camera, type Scene, type WebGLRenderer } from "three";
import { ScenePlayer, type SceneOptions } from "./scene_player";

export { ScenePlayer, type SceneOptions };

/**
 * Add it to a scene; place, turn and scale it (alike in all directions) as any object. `player` plays it.
 *
 * It has no light and no shadows, and is drawn among transparent objects in the order of `renderOrder` and distance. Orthographic
 * cameras, WebGPURenderer and logarithmic depth buffers draw nothing of it, which `player.error` says.
 */
export class DecogsObject extends Mesh {
  readonly player: ScenePlayer;

  constructor(source: string, options: SceneOptions = {}) {
    // Nothing of its own: three.js sets the state that transparent objects have, and calls.
    const geometry = new BufferGeometry();
    geometry.setDrawRange(0, 0);
    super(geometry, new MeshBasicMaterial({ transparent: true, depthWrite: false, colorWrite: true }));
    this.frustumCulled = false;
    this.player = new ScenePlayer(source, options);
  }

  override onAfterRender = (renderer: WebGLRenderer, _scene: Scene, camera: Camera): void => {
    const refused = refusal(renderer);
    if (refused !== null) {
      this.player.refuse(refused);
      return;
    }
    const target = renderer.getRenderTarget();
    this.modelViewMatrix.multiplyMatrices(camera.matrixWorldInverse, this.matrixWorld);
    this.player.draw(renderer.getContext() as WebGL2RenderingContext, {
      modelView: this.modelViewMatrix.elements,
      projection: camera.projectionMatrix.elements,
      linear: target === null ? renderer.outputColorSpace !== SRGBColorSpace : target.texture.colorSpace !== SRGBColorSpace && !isXr(target),
    });
  };

  dispose(): void {
    this.player.dispose();
    this.geometry.dispose();
    (this.material as MeshBasicMaterial).dispose();
  }
}

/** Why a renderer draws no stream; null where it does. */
function refusal(renderer: WebGLRenderer): string | null {
  if ("isWebGPURenderer" in renderer) return "WebGPURenderer draws no .dgs stream: use WebGLRenderer";
  if (renderer.capabilities.logarithmicDepthBuffer) return "a logarithmic depth buffer hides no .dgs stream rightly: make the renderer without";
  return null;
}

/** A headset's target holds what its screen shows. */
function isXr(target: object): boolean {
  return "isXRRenderTarget" in target;
}
