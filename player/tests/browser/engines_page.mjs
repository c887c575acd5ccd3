// In the page: a stream in a scene of three.js and of PlayCanvas, with a wall of one colour, drawn some times and read.
import * as pc from "playcanvas";
import * as three from "three";
import { DecogsEntity } from "../../src/engine/playcanvas";
import { DecogsObject } from "../../src/engine/three";

const FAR = 50;
const nearOf = ({ near }) => near || 0.05;

/** OpenGL's projection of a camera of the stream, by columns. */
function projection(camera) {
  const { width, height, fx, fy, cx, cy } = camera;
  const near = nearOf(camera);
  return [(2 * fx) / width, 0, 0, 0, 0, (2 * fy) / height, 0, 0, 1 - (2 * cx) / width, (2 * cy) / height - 1, -(FAR + near) / (FAR - near), -1, 0, 0, (-2 * FAR * near) / (FAR - near), 0];
}

/** From OpenGL's camera (y up, z back) to the world, by columns. */
function cameraToWorld({ worldToCamera: [x, y, z] }) {
  const centre = [0, 1, 2].map((i) => -(x[i] * x[3] + y[i] * y[3] + z[i] * z[3]));
  const flipped = (row) => [0, 1, 2].map((i) => -row[i]);
  return [...x.slice(0, 3), 0, ...flipped(y), 0, ...flipped(z), 0, ...centre, 1];
}

const shown = async (player, frame) => {
  player.currentFrame = frame;
  while (player.info?.frame !== frame && player.error === null) await new Promise((done) => setTimeout(done, 20));
  if (player.error !== null) throw new Error(player.error);
};

/** Draws until the order is that of the view, and, of a stream that plays, until another frame came; the last picture as PNG. */
async function drawnBy(draw, canvas, gl, player) {
  let frames = 0;
  player.addEventListener("timeupdate", () => frames++);
  gl.getError(); // what the engine did before
  for (let i = 0; i < 12 || (!player.paused && frames < 5); i++) {
    draw();
    await new Promise((done) => setTimeout(done, 50));
  }
  draw();
  return { picture: canvas.toDataURL(), frames, error: gl.getError() };
}

globalThis.drawn = {
  /** `wall`: its depth, null for none; `before`: whether a small wall stands before everything. Seen by the stream's first camera. */
  async three(address, { wall, colour, scale = 1, before = false, play = false, linear = false, frame = 0 }) {
    const stream = new DecogsObject(address, { loop: true });
    await shown(stream.player, frame);
    const lens = stream.player.header.cameras[0];
    const canvas = Object.assign(document.createElement("canvas"), { width: lens.width, height: lens.height });
    const renderer = new three.WebGLRenderer({ canvas, antialias: false });
    renderer.setSize(lens.width, lens.height, false);
    const scene = new three.Scene();
    const paint = new three.Color().setRGB(...colour, three.SRGBColorSpace);
    scene.background = paint;
    const camera = new three.PerspectiveCamera();
    camera.matrixAutoUpdate = false;
    camera.matrix.fromArray(cameraToWorld(lens));
    camera.updateMatrixWorld(true);
    camera.projectionMatrix.fromArray(projection(lens));
    camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
    stream.scale.setScalar(scale);
    scene.add(stream);
    const material = new three.MeshBasicMaterial({ color: paint, side: three.DoubleSide });
    if (wall !== null) {
      const mesh = new three.Mesh(new three.PlaneGeometry(100, 100), material);
      mesh.position.z = wall;
      scene.add(mesh);
    }
    if (before) {
      const mesh = new three.Mesh(new three.PlaneGeometry(0.02, 0.02), new three.MeshBasicMaterial({ color: 0xffff00, side: three.DoubleSide, transparent: true, opacity: 0.5 }));
      mesh.position.z = 0.1;
      mesh.renderOrder = 1;
      scene.add(mesh);
    }
    const target = linear ? new three.WebGLRenderTarget(lens.width, lens.height, { type: three.HalfFloatType }) : null;
    const screen = new three.Scene();
    if (linear) {
      // As OutputPass does it: from light to what screens show.
      screen.add(new three.Mesh(new three.PlaneGeometry(2, 2), new three.MeshBasicMaterial({ map: target.texture })));
      screen.position.z = -1;
    }
    if (play) await stream.player.play();
    const told = await drawnBy(() => {
      renderer.setRenderTarget(target);
      renderer.render(scene, camera);
      if (!linear) return;
      renderer.setRenderTarget(null);
      renderer.render(screen, new three.OrthographicCamera());
    }, canvas, renderer.getContext(), stream.player);
    stream.dispose();
    renderer.dispose();
    return told;
  },

  async playcanvas(address, { wall, colour, scale = 1, before = false, play = false, frame = 0 }) {
    const canvas = document.createElement("canvas");
    document.body.append(canvas);
    const app = new pc.Application(canvas, { graphicsDeviceOptions: { antialias: false } });
    app.autoRender = false;
    app.start();
    const entity = new pc.Entity();
    entity.setLocalScale(scale, scale, scale);
    app.root.addChild(entity);
    const stream = new DecogsEntity(app, entity, address, { loop: true });
    await shown(stream.player, frame);
    const lens = stream.player.header.cameras[0];
    app.setCanvasResolution(pc.RESOLUTION_FIXED, lens.width, lens.height);
    const camera = new pc.Entity();
    camera.addComponent("camera", { clearColor: new pc.Color(...colour), toneMapping: pc.TONEMAP_NONE, nearClip: nearOf(lens), farClip: FAR });
    camera.camera.calculateProjection = (matrix) => matrix.set(projection(lens));
    const place = new pc.Mat4().set(cameraToWorld(lens));
    camera.setPosition(place.getTranslation());
    camera.setRotation(new pc.Quat().setFromMat4(place));
    app.root.addChild(camera);
    const plane = (size, depth, material) => {
      const mesh = new pc.Entity();
      mesh.addComponent("render", { type: "plane", material });
      mesh.setEulerAngles(-90, 0, 0); // its normal towards the camera
      mesh.setLocalPosition(0, 0, depth);
      mesh.setLocalScale(size, 1, size);
      app.root.addChild(mesh);
    };
    const painted = (red, green, blue, opacity) => {
      const material = new pc.StandardMaterial();
      Object.assign(material, { useLighting: false, emissive: new pc.Color(red, green, blue), diffuse: pc.Color.BLACK, cull: pc.CULLFACE_NONE, opacity });
      if (opacity < 1) material.blendType = pc.BLEND_NORMAL;
      material.update();
      return material;
    };
    if (wall !== null) plane(100, wall, painted(...colour, 1));
    if (before) plane(0.02, 0.1, painted(1, 1, 0, 1));
    if (play) await stream.player.play();
    const told = await drawnBy(() => app.render(), canvas, app.graphicsDevice.gl, stream.player);
    stream.destroy();
    app.destroy();
    canvas.remove();
    return told;
  },
};

/** Draws some times, and whether anything was drawn but what lies behind; what the player says of it, and how often. */
async function toldOf(player, draw, canvas) {
  let errors = 0;
  player.addEventListener("error", () => errors++);
  const blank = canvas.toDataURL();
  for (let i = 0; i < 5; i++) {
    draw();
    await new Promise((done) => setTimeout(done, 20));
  }
  draw();
  return { error: player.error, errors, nothing: canvas.toDataURL() === blank };
}

/** How many textures are made of a stream that was given back and is still drawn. */
function texturesBehind(gl, dispose, draw) {
  let made = 0;
  const { createTexture } = gl;
  gl.createTexture = () => (made++, createTexture.call(gl));
  dispose();
  draw();
  return made;
}

/** What is said of a camera, an object or a renderer that no stream can be drawn with. */
globalThis.refused = {
  async three(address, how, WebGPURenderer = null) {
    const stream = new DecogsObject(address);
    await shown(stream.player, 0);
    const canvas = Object.assign(document.createElement("canvas"), { width: 64, height: 48 });
    const options = { canvas, antialias: false, logarithmicDepthBuffer: how === "logarithmic", preserveDrawingBuffer: true };
    const renderer = how === "webgpu" ? new WebGPURenderer({ ...options, forceWebGL: true }) : new three.WebGLRenderer(options);
    await renderer.init?.();
    const camera = how === "orthographic" ? new three.OrthographicCamera(-1, 1, 1, -1, 0, 10) : new three.PerspectiveCamera();
    camera.rotation.y = Math.PI; // streams look along z
    if (how === "uneven") stream.scale.set(1, 2, 1);
    if (how === "mirrored") stream.scale.set(-1, 1, 1);
    if (how === "nothing") stream.scale.setScalar(0);
    const scene = new three.Scene();
    renderer.render(scene, camera);
    scene.add(stream);
    const draw = () => renderer.render(scene, camera);
    const told = await toldOf(stream.player, draw, canvas);
    const behind = texturesBehind(canvas.getContext("webgl2"), () => stream.dispose(), draw);
    renderer.dispose();
    return { ...told, behind };
  },

  async playcanvas(address, how) {
    const canvas = Object.assign(document.createElement("canvas"), { width: 64, height: 48 });
    document.body.append(canvas);
    const app = how === "no WebGL2" ? new pc.AppBase(canvas) : new pc.Application(canvas, { graphicsDeviceOptions: { antialias: false, preserveDrawingBuffer: true } });
    if (how === "no WebGL2") app.init(Object.assign(new pc.AppOptions(), { graphicsDevice: new pc.NullGraphicsDevice(canvas) }));
    app.autoRender = false;
    const entity = new pc.Entity();
    app.root.addChild(entity);
    let stream;
    try {
      stream = new DecogsEntity(app, entity, address);
    } catch (error) {
      return { error: error.message, errors: 1, nothing: true };
    }
    app.start();
    await shown(stream.player, 0);
    app.setCanvasResolution(pc.RESOLUTION_FIXED, 64, 48);
    const camera = new pc.Entity();
    camera.addComponent("camera", { projection: how === "orthographic" ? pc.PROJECTION_ORTHOGRAPHIC : pc.PROJECTION_PERSPECTIVE });
    camera.setEulerAngles(0, 180, 0);
    app.root.addChild(camera);
    if (how === "uneven") entity.setLocalScale(1, 2, 1);
    if (how === "mirrored") entity.setLocalScale(-1, 1, 1);
    if (how === "nothing") entity.setLocalScale(0, 0, 0);
    entity.enabled = false;
    app.render();
    entity.enabled = true;
    const told = await toldOf(stream.player, () => app.render(), canvas);
    const behind = texturesBehind(app.graphicsDevice.gl, () => stream.destroy(), () => app.render());
    app.destroy();
    canvas.remove();
    return { ...told, behind };
  },
};
