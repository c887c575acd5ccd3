/** The worker's exact pictures: the kernel is fetched when the first one is asked for. */
import type { PinholeCamera } from "../geometry/camera";
import { asSeen, recordedPixels } from "../exact/recorded";
import { ExactRenderer } from "../exact/renderer";
import type { ExactPicture } from "../messages";
import type { Gaussians, StreamHeader } from "../scene";

export type LoadKernel = () => Promise<BufferSource>;

export class ExactPictures {
  private kernel: Promise<ExactRenderer> | null = null;

  constructor(private readonly load: LoadKernel) {}

  /** Resolves once `draw` can be called; rejects where the kernel cannot be had, and may be asked again. */
  async ready(): Promise<ExactRenderer> {
    try {
      return await (this.kernel ??= this.load().then((bytes) => ExactRenderer.load(bytes)));
    } catch (error) {
      this.kernel = null;
      throw new Error(`the exact picture is not to be had: ${error instanceof Error ? error.message : String(error)}`);
    }
  }

  draw(exact: ExactRenderer, gaussians: Gaussians, header: StreamHeader, camera: PinholeCamera): ExactPicture {
    const begun = performance.now();
    const pixels = camera.recording || header.subject
      ? recordedPixels(exact, gaussians, header, camera, camera.recording ?? asSeen(camera))
      : exact.draw(gaussians, header.shDegree, camera, header.background);
    return { width: camera.width, height: camera.height, pixels, drawMs: performance.now() - begun };
  }
}
