// In the page: a stream among opaque things of a scene, as its first camera sees it from a little aside, level with its up.
import * as pc from "playcanvas";
import * as three from "three";
import { DecogsEntity } from "../../src/engine/playcanvas";
import { DecogsObject } from "../../src/engine/three";

const shown = async ({ player }) => {
  player.currentFrame = 0;
  while (player.info === null && player.error === null) await new Promise((done) => setTimeout(done, 20));
  if (player.error !== null) throw new Error(player.error);
};

const drawn = async (draw) => {
  for (let i = 0; i < 15; i++) {
    draw();
    await new Promise((done) => setTimeout(done, 100));
  }
};

/** Where the first camera stands, what all of them look at, and how far that is: in the stream's world. */
function seen({ header: { cameras } }) {
  const [x, y, z] = cameras[0].worldToCamera;
  const centre = [0, 1, 2].map((i) => -(x[i] * x[3] + y[i] * y[3] + z[i] * z[3]));
  const middle = [0, 1, 2].map((i) => cameras.reduce((sum, { worldToCamera: [a, b, c] }) => sum - (a[i] * a[3] + b[i] * b[3] + c[i] * c[3]), 0) / cameras.length);
  const far = Math.max(0.5, Math.hypot(...centre.map((value, i) => value - middle[i])));
  return { centre, far, target: centre.map((value, i) => value + far * z[i]), fov: (360 / Math.PI) * Math.atan(cameras[0].height / 2 / cameras[0].fy) };
}

globalThis.scenes = {
  async three(address) {
    const stream = new DecogsObject(address);
    await shown(stream);
    const { centre, target, far, fov } = seen(stream.player);
    const renderer = new three.WebGLRenderer({ antialias: true });
    renderer.setSize(innerWidth, innerHeight);
    document.body.append(renderer.domElement);
    const scene = new three.Scene();
    scene.background = new three.Color().setRGB(...stream.player.header.background, three.SRGBColorSpace);
    scene.add(new three.HemisphereLight(0xffffff, 0x666677, 3));
    stream.quaternion.setFromUnitVectors(new three.Vector3(...stream.player.up), new three.Vector3(0, 1, 0));
    scene.add(stream);
    stream.updateMatrixWorld();
    const [eye, aim] = [centre, target].map((place) => new three.Vector3(...place).applyMatrix4(stream.matrixWorld));
    const camera = new three.PerspectiveCamera(fov, innerWidth / innerHeight, far / 100, 100 * far);
    camera.position.copy(eye).lerp(aim, -0.3);
    camera.lookAt(aim);
    const add = (geometry, colour, place) => {
      const mesh = new three.Mesh(geometry, new three.MeshLambertMaterial({ color: colour }));
      mesh.position.copy(place);
      scene.add(mesh);
      return mesh;
    };
    const across = new three.Vector3().crossVectors(aim.clone().sub(eye), new three.Vector3(0, 1, 0)).normalize();
    add(new three.BoxGeometry(0.15 * far, 0.15 * far, 0.15 * far), 0xd05030, eye.clone().lerp(aim, 0.6).addScaledVector(across, 0.15 * far));
    add(new three.TorusKnotGeometry(0.1 * far, 0.03 * far), 0x30a070, aim.clone().addScaledVector(across, -0.2 * far));
    await drawn(() => renderer.render(scene, camera));
  },

  async playcanvas(address) {
    const canvas = document.createElement("canvas");
    document.body.append(canvas);
    const app = new pc.Application(canvas, { graphicsDeviceOptions: { antialias: true } });
    app.setCanvasResolution(pc.RESOLUTION_FIXED, innerWidth, innerHeight);
    app.autoRender = false;
    app.start();
    app.scene.ambientLight = new pc.Color(0.5, 0.5, 0.5);
    const entity = new pc.Entity();
    app.root.addChild(entity);
    const stream = new DecogsEntity(app, entity, address);
    await shown(stream);
    const { centre, target, far, fov } = seen(stream.player);
    entity.setRotation(new pc.Quat().setFromDirections(new pc.Vec3(stream.player.up), pc.Vec3.UP));
    const [eye, aim] = [centre, target].map((place) => entity.getWorldTransform().transformPoint(new pc.Vec3(place)));
    const camera = new pc.Entity();
    camera.addComponent("camera", { clearColor: new pc.Color(stream.player.header.background), fov, nearClip: far / 100, farClip: 100 * far });
    camera.setPosition(new pc.Vec3().lerp(eye, aim, -0.3));
    camera.lookAt(aim);
    app.root.addChild(camera);
    const light = new pc.Entity();
    light.addComponent("light", { type: "directional" });
    light.setEulerAngles(45, 30, 0);
    app.root.addChild(light);
    const add = (type, [red, green, blue], place) => {
      const material = new pc.StandardMaterial();
      material.diffuse = new pc.Color(red, green, blue);
      material.update();
      const mesh = new pc.Entity();
      mesh.addComponent("render", { type, material });
      mesh.setPosition(place);
      mesh.setLocalScale(0.15 * far, 0.15 * far, 0.15 * far);
      app.root.addChild(mesh);
    };
    const across = new pc.Vec3().cross(aim.clone().sub(eye), pc.Vec3.UP).normalize();
    const aside = (part) => across.clone().mulScalar(part * far);
    add("box", [0.8, 0.3, 0.2], new pc.Vec3().lerp(eye, aim, 0.6).add(aside(0.15)));
    add("sphere", [0.2, 0.6, 0.4], aim.clone().add(aside(-0.2)));
    await drawn(() => app.render());
  },
};
