/**
 * The exact picture: the decoder's own kernel as WebAssembly, on one thread, without a graphics card.
 *
 * Its floats are those of `decogs.decoder.render_view`, bit for bit. The kernel takes stored values: scales and opacities
 * are activated in it, by its own polynomials, so nothing here computes an exponential. What is computed here, the camera,
 * is the float64 arithmetic of decoder/rasterise/native.py in the same order.
 */
import type { PinholeCamera } from "../geometry/camera";
import type { Gaussians } from "../scene";

/** What a camera sees, planes of height x width floats: red, green and blue, alpha, depth weighted by alpha. */
export interface ExactPlanes {
  readonly rgb: Float32Array;
  readonly alpha: Float32Array;
  readonly depth: Float32Array;
}

/** A scene that covers the picture too many times, or needs more memory than the browser gives. */
export class ExactError extends Error {
  override readonly name = "ExactError";
}

interface Kernel {
  readonly memory: WebAssembly.Memory;
  _initialize(): void;
  exact_failure(): number;
  exact_scene(count: number, shDegree: number): number;
  exact_camera(): number;
  exact_draw(red: number, green: number, blue: number, maxPairs: number): number;
  exact_pixels(): number;
}

/** Cameras further from the origin than this see positions from where they are (native.py, FAR_OUT). */
const FAR_OUT = 256;
/** Pairs of a 16x16 tile and a Gaussian that a picture may list: half a gigabyte. */
const MAX_PAIRS = 1 << 24;
/** Width times height of a picture: what 16384 x 8192 has would not fit beside its planes. */
const MAX_PIXELS = 1 << 25;
const COVERED = 1;
/** Floats of a Gaussian beside its SH: mean, log scales, quaternion, opacity logit. */
const GEOMETRY = 11;

/** Draws scenes with the decoder's kernel. One picture at a time; arrays that it returns are the caller's. */
export class ExactRenderer {
  private constructor(
    private readonly module: WebAssembly.Module,
    private kernel: Kernel,
  ) {}

  /** Compiles decogs-exact.wasm; rejects with what the browser says where it cannot (fixed-width SIMD is needed). */
  static async load(bytes: BufferSource): Promise<ExactRenderer> {
    const module = await WebAssembly.compile(bytes);
    return new ExactRenderer(module, await instance(module));
  }

  /**
   * The picture as bytes, RGBA and opaque, rows from the top: what decogs-decode writes into a PNG.
   *
   * `background`: display-referred red, green, blue. Throws ExactError; the next picture may be another one.
   */
  draw(
    gaussians: Gaussians,
    shDegree: number,
    camera: PinholeCamera,
    background: readonly number[],
  ): Uint8ClampedArray<ArrayBuffer> {
    return this.guarded(() => {
      this.render(gaussians, shDegree, camera, background);
      const at = allocated(this.kernel.exact_pixels());
      return new Uint8ClampedArray(this.kernel.memory.buffer, at, 4 * camera.width * camera.height).slice();
    });
  }

  /** The picture in floats, as the kernel makes it. Throws ExactError. */
  planes(gaussians: Gaussians, shDegree: number, camera: PinholeCamera, background: readonly number[]): ExactPlanes {
    return this.guarded(() => {
      const at = this.render(gaussians, shDegree, camera, background);
      const plane = camera.width * camera.height;
      const all = new Float32Array(this.kernel.memory.buffer, at, 5 * plane).slice();
      return {
        rgb: all.subarray(0, 3 * plane),
        alpha: all.subarray(3 * plane, 4 * plane),
        depth: all.subarray(4 * plane),
      };
    });
  }

  private render(
    gaussians: Gaussians,
    shDegree: number,
    camera: PinholeCamera,
    background: readonly number[],
  ): number {
    if (!(camera.width >= 1 && camera.height >= 1 && camera.width * camera.height <= MAX_PIXELS)) {
      throw new ExactError(`a picture of ${camera.width}x${camera.height} cannot be drawn exactly; choose a smaller one`);
    }
    this.placeScene(gaussians, shDegree);
    this.placeCamera(camera);
    const [red, green, blue] = background;
    return allocated(this.kernel.exact_draw(red, green, blue, MAX_PAIRS));
  }

  private placeScene(gaussians: Gaussians, shDegree: number): void {
    const { count, order } = gaussians;
    const colours = 3 * (shDegree + 1) ** 2;
    const at = allocated(this.kernel.exact_scene(count, shDegree));
    const room = new Float32Array(this.kernel.memory.buffer, at, count * (GEOMETRY + colours));
    // Of Gaussians at equal depth the one that comes first in the stream is in front.
    let to = 0;
    const parts: readonly (readonly [Float32Array, number])[] = [
      [gaussians.means, 3],
      [gaussians.logScales, 3],
      [gaussians.quaternions, 4],
      [gaussians.opacityLogits, 1],
      [gaussians.sh, colours],
    ];
    for (const [values, width] of parts) {
      if (order === null) room.set(values.subarray(0, width * count), to);
      else gather(values, width, order, room.subarray(to, to + width * count));
      to += width * count;
    }
  }

  private placeCamera(camera: PinholeCamera): void {
    const at = this.kernel.exact_camera();
    new Float32Array(this.kernel.memory.buffer, at, 23).set(cameraFloats(camera));
    new Int32Array(this.kernel.memory.buffer, at + 4 * 23, 2).set([camera.width, camera.height]);
  }

  /** A trap leaves the kernel's memory as it stood: the next picture gets a new one. */
  private guarded<Result>(work: () => Result): Result {
    try {
      return work();
    } catch (error) {
      if (!(error instanceof WebAssembly.RuntimeError)) throw error;
      const covered = this.kernel.exact_failure() === COVERED;
      this.kernel = started(new WebAssembly.Instance(this.module, imports(this.module)));
      throw new ExactError(
        covered
          ? "the picture is covered too many times by the scene's Gaussians; choose a smaller one"
          : "there is not enough memory for the exact picture; choose a smaller one",
      );
    }
  }
}

/** A camera as the kernel reads it (kernel/project.h): what `native_camera` in native.py makes of the same one. */
export function cameraFloats(camera: PinholeCamera): number[] {
  const pose = camera.worldToCamera;
  const at = [0, 1, 2];
  const rotation = at.map((row) => at.map((column) => pose[row][column]));
  const translation = at.map((row) => pose[row][3]);
  const transposed = at.map((row) => at.map((column) => rotation[column][row]));
  const centre = turned(transposed, translation).map((value) => -value);
  const distance = Math.sqrt(centre.reduce((sum, value) => sum + value * value, 0));
  const origin = distance > FAR_OUT ? centre.map(Math.fround) : [0, 0, 0];
  const shift = turned(rotation, origin);
  return [
    ...rotation.flat(),
    ...translation.map((value, axis) => value + shift[axis]),
    ...centre.map((value, axis) => value - origin[axis]),
    ...origin,
    camera.fx,
    camera.fy,
    camera.cx,
    camera.cy,
    camera.near,
  ];
}

/** The matrix times the vector, summed in the order of `decogs.formats.cameras.turned`. */
function turned(rotation: readonly (readonly number[])[], vector: readonly number[]): number[] {
  const [x, y, z] = vector as [number, number, number];
  return rotation.map((row) => x * row[0] + y * row[1] + z * row[2]);
}

/** Rows of `width` floats from their slots. */
function gather(values: Float32Array, width: number, order: Uint32Array, room: Float32Array): void {
  let to = 0;
  for (let row = 0; to < room.length; row++) {
    for (let from = width * order[row], end = from + width; from < end; from++) room[to++] = values[from];
  }
}

function allocated(address: number): number {
  if (address === 0) throw new ExactError("there is not enough memory for the exact picture; choose a smaller one");
  return address;
}

async function instance(module: WebAssembly.Module): Promise<Kernel> {
  return started(await WebAssembly.instantiate(module, imports(module)));
}

function started(instance: WebAssembly.Instance): Kernel {
  const kernel = instance.exports as unknown as Kernel;
  kernel._initialize();
  return kernel;
}

/** The C++ library can tell a terminal why it ends; here nobody listens, and each such call fails with EBADF. */
function imports(module: WebAssembly.Module): WebAssembly.Imports {
  const wanted: Record<string, Record<string, () => number>> = {};
  for (const { module: from, name } of WebAssembly.Module.imports(module)) (wanted[from] ??= {})[name] = () => 8;
  return wanted;
}
