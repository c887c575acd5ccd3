// In the page: what draws a frame, ours or another, told to draw from places on a circle, one picture after the other.
import { SparkRenderer, SplatMesh } from "@sparkjsdev/spark";
import * as pc from "playcanvas";
import * as three from "three";

const MEASURED_MS = 6000;
const STEP = 0.02;

/** The camera that stands there, turned about what the rig looks at. */
function placed(camera, pivot, up, angle) {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const [x, y, z] = up;
  const t = 1 - c;
  const turn = [
    [t * x * x + c, t * x * y - s * z, t * x * z + s * y],
    [t * x * y + s * z, t * y * y + c, t * y * z - s * x],
    [t * x * z - s * y, t * y * z + s * x, t * z * z + c],
  ];
  // x' = R (x - p) + p, so that the camera sees W (R^T (x' - p) + p).
  const rows = camera.worldToCamera.map((row) => {
    const axis = [0, 1, 2].map((k) => [0, 1, 2].reduce((sum, i) => sum + row[i] * turn[k][i], 0));
    const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    return [...axis, row[3] + dot(row, pivot) - dot(axis, pivot)];
  });
  return { ...camera, worldToCamera: rows };
}

/** OpenGL's projection, by columns. */
function projection({ width, height, fx, fy, cx, cy }, near, far) {
  const depth = [-(far + near) / (far - near), (-2 * far * near) / (far - near)];
  return [(2 * fx) / width, 0, 0, 0, 0, (2 * fy) / height, 0, 0, 1 - (2 * cx) / width, (2 * cy) / height - 1, depth[0], -1, 0, 0, depth[1], 0];
}

/** From OpenGL's camera (y up, z back) to the world, by columns. */
function cameraToWorld({ worldToCamera: [x, y, z] }) {
  const centre = [0, 1, 2].map((i) => -(x[i] * x[3] + y[i] * y[3] + z[i] * z[3]));
  const flipped = (row) => [0, 1, 2].map((i) => -row[i]);
  return [...x.slice(0, 3), 0, ...flipped(y), 0, ...flipped(z), 0, ...centre, 1];
}

async function ours(player, automatic, width, height) {
  player.style.cssText = `width: ${width}px; height: ${height}px`;
  player.setAttribute("exact", automatic ? "" : "off");
  const { stage } = player[Symbol.for("decogs.inside")];
  await player.capture(width, height);
  return {
    /** While the camera moves, as slow pictures are drawn then; or as it stands. */
    draw: async (camera, still = false) => {
      const { renderer } = stage;
      stage.sortFor(camera.worldToCamera[2]);
      renderer.draw(camera, "none", !still);
      await renderer.settled?.();
      const gl = renderer.canvas.getContext("webgl2");
      gl?.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    },
    canvas: () => stage.renderer.canvas,
  };
}

async function spark(ply, canvas, width, height, background) {
  const renderer = new three.WebGLRenderer({ canvas, antialias: false, preserveDrawingBuffer: true });
  renderer.setSize(width, height, false);
  renderer.setClearColor(new three.Color().setRGB(...background, three.SRGBColorSpace));
  const scene = new three.Scene();
  scene.add(new SparkRenderer({ renderer }));
  const mesh = new SplatMesh({ fileBytes: ply, fileName: "frame.ply" });
  await mesh.initialized;
  scene.add(mesh);
  const view = new three.PerspectiveCamera();
  const gl = renderer.getContext();
  return {
    draw: async (camera) => {
      view.matrixAutoUpdate = false;
      view.matrix.fromArray(cameraToWorld(camera));
      view.matrix.decompose(view.position, view.quaternion, view.scale);
      view.updateMatrixWorld(true);
      view.projectionMatrix.fromArray(projection(camera, camera.near || 0.01, 1000));
      view.projectionMatrixInverse.copy(view.projectionMatrix).invert();
      renderer.render(scene, view);
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    },
    canvas: () => canvas,
  };
}

async function playCanvas(ply, canvas, width, height, background) {
  const app = new pc.Application(canvas, { graphicsDeviceOptions: { antialias: false, preserveDrawingBuffer: true } });
  app.setCanvasResolution(pc.RESOLUTION_FIXED, width, height);
  app.autoRender = false;
  app.start();
  const asset = new pc.Asset("frame.ply", "gsplat", { url: URL.createObjectURL(new Blob([ply])), filename: "frame.ply" });
  await new Promise((done, failed) => {
    asset.on("load", done);
    asset.on("error", failed);
    app.assets.add(asset);
    app.assets.load(asset);
  });
  const splats = new pc.Entity();
  splats.addComponent("gsplat", { asset });
  app.root.addChild(splats);
  const view = new pc.Entity();
  let camera = null;
  view.addComponent("camera", { clearColor: new pc.Color(...background), toneMapping: pc.TONEMAP_NONE, gammaCorrection: pc.GAMMA_SRGB });
  view.camera.calculateProjection = (matrix) => matrix.set(projection(camera, camera.near || 0.01, 1000));
  view.camera.calculateTransform = (matrix) => matrix.set(cameraToWorld(camera));
  app.root.addChild(view);
  const gl = app.graphicsDevice.gl;
  return {
    draw: async (asked) => {
      camera = asked;
      view.camera.nearClip = asked.near || 0.01;
      const place = new pc.Mat4().set(cameraToWorld(asked));
      view.setPosition(place.getTranslation());
      view.setRotation(new pc.Quat().setFromMat4(place));
      app.render();
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    },
    canvas: () => canvas,
  };
}

const pause = (ms) => new Promise((done) => setTimeout(done, ms));

function pixels(canvas, width, height) {
  const copy = new OffscreenCanvas(width, height);
  const context = copy.getContext("2d");
  context.drawImage(canvas, 0, 0);
  return context.getImageData(0, 0, width, height).data;
}

globalThis.measured = async (who, width, height) => {
  const player = document.querySelector("decogs-player");
  const { navigation } = player[Symbol.for("decogs.inside")].stage;
  const { pivot, up } = navigation;
  const background = player.header.background.map((value) => Math.min(1, Math.max(0, value)));
  const camera = player.currentCamera(width, height);
  player.setAttribute("exact", "off");
  const image = await createImageBitmap(await player.capture(width, height));
  const expected = pixels(image, width, height);
  const gaussians = player.info.count;
  let drawer;
  if (who.startsWith("decogs")) drawer = await ours(player, who !== "decogs, WebGL2", width, height);
  else {
    const ply = new Uint8Array(await (await player.ply()).arrayBuffer());
    player.remove();
    const canvas = Object.assign(document.createElement("canvas"), { width, height });
    document.body.replaceChildren(canvas);
    drawer = await (who === "Spark" ? spark : playCanvas)(ply, canvas, width, height, background);
  }
  // Sorting comes from workers: the first pictures have none.
  for (let i = 0; i < 8; i++) {
    await drawer.draw(camera);
    await pause(200);
  }
  await drawer.draw(camera, true);
  const found = pixels(drawer.canvas(), width, height);
  let sum = 0;
  for (let at = 0; at < found.length; at++) if (at % 4 !== 3) sum += (found[at] - expected[at]) ** 2;
  const likeOurs = Math.round(100 * Math.log10((255 ** 2 * width * height * 3) / sum)) / 10;
  let count = 0;
  const begun = performance.now();
  for (let angle = 0; performance.now() - begun < MEASURED_MS; count++) {
    angle += STEP;
    await drawer.draw(placed(camera, pivot, up, 0.3 * Math.sin(angle)));
    await pause(0); // what workers say comes in between
  }
  return { gaussians, likeOurs, pictures: (1000 * count) / (performance.now() - begun) };
};
