import type { Matrix } from "../geometry/vectors";

/** The unit quaternion, w x y z, of a rotation; the component that is largest is positive. */
export function quaternionOf([[a, b, c], [d, e, f], [g, h, i]]: Matrix): readonly [number, number, number, number] {
  const rows = [
    [1 + a + e + i, h - f, c - g, d - b],
    [h - f, 1 + a - e - i, b + d, c + g],
    [c - g, b + d, 1 - a + e - i, f + h],
    [d - b, c + g, f + h, 1 - a - e + i],
  ];
  const best = rows.reduce((most, row, at) => (row[at] > rows[most][most] ? at : most), 0);
  const norm = Math.hypot(...rows[best]);
  return rows[best].map((value) => value / norm) as [number, number, number, number];
}
