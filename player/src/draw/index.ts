/** Makes what draws. The exact kernel joins here: whoever asks for a renderer needs to know nothing else of it. */
import { WebGlRenderer } from "./webgl_renderer";

/**
 * `onRestored`: everything has to be loaded again. `onLost`: the graphics card is gone, for how long nobody knows. Throws an
 * Error that says so where the browser cannot draw.
 */
export function createRenderer(canvas: HTMLCanvasElement, onRestored: () => void, onLost: () => void): WebGlRenderer {
  return new WebGlRenderer(canvas, onRestored, onLost);
}
