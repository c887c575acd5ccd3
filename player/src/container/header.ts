/** The header packet (SPEC section 4): every member there and within its bounds. */

import type { CameraColours, LampWave, Lattice, RigCamera, StreamHeader } from "../scene";
import { refuse } from "./errors";
import { JsonNumber, parseJson, type JsonObject, type JsonValue } from "./json";
import { MAX_CAMERAS, MAX_HEADER_BYTES, MAX_IMAGE_SIDE } from "./limits";
import { readLayers } from "./layers";
import { readPresentation } from "./presentation";
import { readSoundTracks } from "./sound";

const MAX_TEXT = 65_536;
const MAX_LIST = 1024;
const MAX_LAMP_CELLS = 16;
const COEFFICIENTS = { none: [0], opencv: [4, 5, 8], fisheye: [4] } as const;
/** Effects whose parameters each frame's corrections block has (SPEC section 6). */
export const CORRECTED_EFFECTS = ["exposure_drift", "white_balance_drift", "camera_shake", "lamp_flicker"] as const;
const LAMPS = "lamp_flicker";
const ALWAYS_LIT = 4096;
const EFFECTS: ReadonlySet<string> = new Set([
  "motion",
  "appearance_change",
  "emergence",
  "disappearance",
  "view_dependence",
  "lens_distortion",
  "colour_mismatch",
  "lens_falloff",
  ...CORRECTED_EFFECTS,
]);

export function readHeader(payload: Uint8Array): StreamHeader {
  if (payload.length > MAX_HEADER_BYTES) refuse("too-large", `a header of ${payload.length} bytes is above the limit`);
  const members = object(parseJson(payload), "the header");
  const effects = names(members, "effects");
  const corrected = readCorrected(members, effects);
  const cameras = list(members, "cameras", 1, MAX_CAMERAS).map(readCamera).map(alwaysLit(corrected.get(LAMPS) ?? []));
  const heldOut = names(members, "held_out");
  const header: StreamHeader = {
    cameras,
    lattice: readLattice(object(member(members, "lattice"), "lattice")),
    shDegree: integer(member(members, "sh_degree"), "sh_degree", 0, 3),
    fps: readFps(member(members, "fps")),
    firstFrame: integer(member(members, "first_frame"), "first_frame", 0, 2 ** 31 - 1),
    background: vector(member(members, "background"), "background", 3, -1000, 1000),
    effects,
    heldOut,
    corrected,
    subject: readFlag(members, "subject"),
    presentation: readPresentation(members.get("presentation"), cameras.map(({ name }) => name)),
    sound: readSoundTracks(members.get("sound"), readFps(member(members, "fps"))),
    layers: readLayers(members.get("layers")),
  };
  checkTexts(members);
  checkCameras(header);
  checkCorrected(header);
  for (const effect of effects) {
    if (!EFFECTS.has(effect)) refuse("unsupported-effect", `the stream needs an effect unknown here: ${effect}`);
  }
  return { ...header, cameras: withExpectedFalloff(header) };
}

/** Held-out cameras with the fall-off of the middle one of the others (SPEC section 6, "Corrections"). */
function withExpectedFalloff({ cameras, heldOut }: StreamHeader): RigCamera[] {
  const others = cameras.filter(({ name }) => !heldOut.includes(name)).map((camera) => camera.falloff);
  const middle = others.sort((a, b) => a - b)[Math.floor((others.length - 1) / 2)] ?? 0;
  return cameras.map((camera) => (heldOut.includes(camera.name) ? { ...camera, falloff: middle } : camera));
}

/** Whether the member is there; it can only be true. */
function readFlag(members: JsonObject, name: string): boolean {
  const value = members.get(name) ?? false;
  if (members.has(name) && value !== true) bad(`${name} must be true where it is there`);
  return value === true;
}

function readFps(value: JsonValue): number | null {
  return value === null ? null : number(value, "fps", 1e-6, 1e6);
}

function checkTexts(members: JsonObject): void {
  for (const name of ["axes", "units", "source_text", "licence", "writer"]) {
    const text = member(members, name);
    if (typeof text !== "string" || characters(text) > MAX_TEXT) bad(`${name} must be a text`);
  }
  object(member(members, "settings"), "settings");
}

function readLattice(members: JsonObject): Lattice {
  const step = (name: string, most = 1e6): number => number(member(members, name), name, 1e-12, most);
  return {
    origin: vector(member(members, "origin"), "origin", 3, -1e12, 1e12),
    means: vector(member(members, "means"), "means", 3, 1e-12, 1e6),
    logScales: step("log_scales"),
    quaternions: step("quaternions", 0.5),
    opacityLogits: step("opacity_logits"),
    shDc: step("sh_dc"),
    shRest: step("sh_rest"),
  };
}

function readCamera(value: JsonValue): RigCamera {
  const members = object(value, "a camera");
  const real = (name: string, least: number, most: number): number => number(member(members, name), name, least, most);
  const side = (name: string): number => integer(member(members, name), name, 1, MAX_IMAGE_SIDE);
  return {
    name: readName(member(members, "name"), "a camera's name"),
    width: side("width"),
    height: side("height"),
    fx: real("fx", 1e-3, 1e9),
    fy: real("fy", 1e-3, 1e9),
    cx: real("cx", -1e9, 1e9),
    cy: real("cy", -1e9, 1e9),
    ...readLens(members),
    worldToCamera: readPose(members),
    near: members.has("near") ? real("near", 0, 1e12) : 0,
    colours: members.has("colours") ? readColours(member(members, "colours")) : null,
    falloff: members.has("falloff") ? integer(member(members, "falloff"), "falloff", 1, 32_767) : 0,
    lamp: members.has("lamp") ? readLamp(object(member(members, "lamp"), "lamp")) : null,
    lampAmplitude: 0,
  };
}

/** A camera, whose lamps are those of every frame alike unless frames tell of them. */
function alwaysLit(told: readonly string[]): (camera: RigCamera) => RigCamera {
  return (camera) => (camera.lamp === null || told.includes(camera.name) ? camera : { ...camera, lampAmplitude: ALWAYS_LIT });
}

function readLamp(members: JsonObject): LampWave {
  const [columns, rows] = ["columns", "rows"].map((side) => integer(member(members, side), side, 1, MAX_LAMP_CELLS));
  const map = (name: string): number[] => {
    const values = list(members, name, 3 * columns * rows, 3 * columns * rows);
    return values.map((item) => integer(item, name, -32_767, 32_767));
  };
  const hertz = number(member(members, "hertz"), "hertz", 1, 1e6);
  const readout = number(member(members, "readout"), "readout", -1, 1);
  return { hertz, readout, columns, rows, sine: map("sine"), cosine: map("cosine") };
}

function readLens(members: JsonObject): Pick<RigCamera, "distortionModel" | "distortion"> {
  const model = member(members, "distortion_model");
  if (model !== "none" && model !== "opencv" && model !== "fisheye") bad("distortion_model is unknown");
  const counts: readonly number[] = COEFFICIENTS[model];
  const coefficients = list(members, "distortion", 0, 8);
  if (!counts.includes(coefficients.length)) bad(`distortion must have ${counts.join(", ")} coefficients`);
  return { distortionModel: model, distortion: coefficients.map((item) => number(item, "distortion", -1e6, 1e6)) };
}

function readPose(members: JsonObject): number[][] {
  const rows = list(members, "world_to_camera", 3, 3).map((row) => vector(row, "world_to_camera", 4, -1e12, 1e12));
  for (let i = 0; i < 3; i++) {
    for (let j = 0; j < 3; j++) {
      const product = rows[i][0] * rows[j][0] + rows[i][1] * rows[j][1] + rows[i][2] * rows[j][2];
      if (!(Math.abs(product - Number(i === j)) <= 0.01)) bad("world_to_camera holds no rotation");
    }
  }
  if (!(determinant(rows) > 0)) bad("world_to_camera mirrors");
  return rows;
}

function determinant([a, b, c]: number[][]): number {
  return (
    a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])
  );
}

function readColours(value: JsonValue): CameraColours {
  if (!Array.isArray(value) || value.length !== 3) bad("colours must be three integers");
  const [exposure, red, blue] = value.map((item) => integer(item, "colours", -32_767, 32_767));
  return { exposure, red, blue };
}

function checkCameras({ cameras, effects, heldOut }: StreamHeader): void {
  const names = new Set(cameras.map((camera) => camera.name));
  if (names.size < cameras.length) bad("two cameras have one name");
  if (!heldOut.every((name) => names.has(name))) bad("held_out names an unknown camera");
  const coloured = cameras.filter((camera) => camera.colours !== null);
  const darkened = cameras.filter((camera) => camera.falloff !== 0);
  const lit = cameras.filter((camera) => camera.lamp !== null);
  if ([...coloured, ...darkened, ...lit].some((camera) => heldOut.includes(camera.name))) bad("a held-out camera has colours");
  if (coloured.length > 0 !== effects.includes("colour_mismatch")) bad("colours and colour_mismatch disagree");
  if (darkened.length > 0 !== effects.includes("lens_falloff")) bad("falloff and lens_falloff disagree");
}

function readCorrected(members: JsonObject, effects: readonly string[]): Map<string, string[]> {
  const value = members.get("corrected");
  const lists = value === undefined ? new Map<string, JsonValue>() : object(value, "corrected");
  const corrected = new Map<string, string[]>();
  for (const effect of CORRECTED_EFFECTS) {
    const cameras = lists.has(effect) ? names(lists, effect) : [];
    if (cameras.length > 0 !== effects.includes(effect) && effect !== LAMPS) bad(`corrected and effects disagree about ${effect}`);
    if (cameras.length > 0) corrected.set(effect, cameras);
  }
  return corrected;
}

function checkCorrected({ cameras, effects, heldOut, corrected }: StreamHeader): void {
  const seen = new Set(cameras.map((camera) => camera.name));
  for (const name of heldOut) seen.delete(name);
  for (const [effect, names] of corrected) {
    if (new Set(names).size < names.length) bad(`corrected names a camera twice: ${effect}`);
    if (!names.every((name) => seen.has(name))) bad(`corrected names a camera that training did not see: ${effect}`);
  }
  const lit = cameras.filter(({ lamp }) => lamp !== null).map(({ name }) => name);
  if (lit.length > 0 !== effects.includes(LAMPS)) bad("lamps and lamp_flicker disagree");
  if (!(corrected.get(LAMPS) ?? []).every((name) => lit.includes(name))) bad("lamp_flicker names a camera without a lamp");
}

// Members and their types.

function bad(message: string): never {
  refuse("bad-header", message);
}

function member(members: JsonObject, name: string): JsonValue {
  const value = members.get(name);
  if (value === undefined) bad(`the header has no ${name}`);
  return value;
}

function object(value: JsonValue, name: string): JsonObject {
  if (!(value instanceof Map)) bad(`${name} must be an object`);
  return value;
}

function list(members: JsonObject, name: string, least: number, most: number): JsonValue[] {
  const value = member(members, name);
  if (!Array.isArray(value) || value.length < least || value.length > most) bad(`${name} must be a list of its length`);
  return value;
}

function vector(value: JsonValue, name: string, length: number, least: number, most: number): number[] {
  if (!Array.isArray(value) || value.length !== length) bad(`${name} must be ${length} numbers`);
  return value.map((item) => number(item, name, least, most));
}

function number(value: JsonValue, name: string, least: number, most: number): number {
  const inside = value instanceof JsonNumber && least <= value.value && value.value <= most;
  return inside ? value.value : bad(`${name} must be a number from ${least} to ${most}`);
}

function integer(value: JsonValue, name: string, least: number, most: number): number {
  const whole = value instanceof JsonNumber && value.integer;
  return whole ? number(value, name, least, most) : bad(`${name} must be an integer`);
}

function names(members: JsonObject, name: string): string[] {
  return list(members, name, 0, MAX_LIST).map((item) => readName(item, name));
}

function readName(value: JsonValue, what: string): string {
  if (typeof value !== "string" || value === "." || value === ".." || /[\u0000-\u001f\u007f-\u009f/\\]/.test(value)) {
    bad(`${what} must be a name`);
  }
  const length = characters(value);
  if (length < 1 || length > 255) bad(`${what} must have 1 to 255 characters`);
  return value;
}

/** Unicode code points. */
function characters(text: string): number {
  return Array.from(text).length;
}
