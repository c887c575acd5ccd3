/** How a stream wants to be shown (SPEC section 4, "Presentation"): what is out of its bounds counts as absent. */
import type { Similarity } from "../geometry/similarity";
import { cross, dot, times, type Matrix } from "../geometry/vectors";
import type { Presentation } from "../scene";
import { JsonNumber, type JsonValue } from "./json";

const MAX_TITLE = 65_536;
const MAX_POSTER = 2 ** 31 - 1;
const MAX_COORDINATE = 1e12;
const MAX_SCALE = 1e6;
const RIGID_TOLERANCE = 0.01;

/** `cameras`: the stream's, by name. */
export function readPresentation(member: JsonValue | undefined, cameras: readonly string[]): Presentation {
  const members = member instanceof Map ? member : new Map<string, JsonValue>();
  const [title, poster, firstView] = ["title", "poster", "first_view"].map((name) => members.get(name));
  const isFrame = poster instanceof JsonNumber && poster.integer && poster.value >= 0 && poster.value <= MAX_POSTER;
  return {
    title: typeof title === "string" && Array.from(title).length <= MAX_TITLE ? title : "",
    poster: isFrame ? poster.value : null,
    firstView: typeof firstView === "string" && cameras.includes(firstView) ? firstView : null,
    transform: similarityOf(members.get("transform")),
  };
}

function similarityOf(value: JsonValue | undefined): Similarity | null {
  const rows = rowsOf(value);
  if (rows === null) return null;
  const parts = rows.map(([x, y, z]) => [x, y, z] as const) as unknown as Matrix;
  const scale = Math.cbrt(dot(parts[0], cross(parts[1], parts[2])));
  if (!(scale >= 1 / MAX_SCALE && scale <= MAX_SCALE)) return null;
  const rotation = parts.map((row) => times(row, 1 / scale)) as unknown as Matrix;
  const isRotation = rotation.every((a, i) => rotation.every((b, j) => Math.abs(dot(a, b) - Number(i === j)) <= RIGID_TOLERANCE));
  return isRotation ? { rotation, scale, shift: [rows[0][3], rows[1][3], rows[2][3]] } : null;
}

/** Three rows of four numbers, none too large; null for anything else. */
function rowsOf(value: JsonValue | undefined): number[][] | null {
  if (!Array.isArray(value) || value.length !== 3) return null;
  const rows = value.map((row) => (Array.isArray(row) && row.length === 4 ? row : []));
  const numbers = rows.map((row) => row.flatMap((each) => (each instanceof JsonNumber && Math.abs(each.value) <= MAX_COORDINATE ? [each.value] : [])));
  return numbers.every((row) => row.length === 4) ? numbers : null;
}
