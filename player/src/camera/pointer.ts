/** Mouse, pen and touch: one pointer circles, two pan and zoom; right, middle or with shift a mouse pans; the wheel zooms. */
import type { Navigation } from "./navigation";

/** Radians that a drag across the whole picture turns by. */
const TURN_ACROSS = Math.PI * 1.1;
const WHEEL_STEP = 0.0012;

interface Point {
  x: number;
  y: number;
}

/** Listens until the function that it returns is called; `moved` is told of every movement. */
export function attachPointer(surface: HTMLElement, navigation: Navigation, moved: () => void): () => void {
  const down = new Map<number, Point>();
  const options = new AbortController();
  const listen = <K extends keyof HTMLElementEventMap>(name: K, handle: (event: HTMLElementEventMap[K]) => void): void => {
    surface.addEventListener(name, handle, { signal: options.signal, passive: false });
  };

  listen("pointerdown", (event) => {
    surface.setPointerCapture(event.pointerId);
    down.set(event.pointerId, { x: event.clientX, y: event.clientY });
  });
  for (const name of ["pointerup", "pointercancel"] as const) {
    listen(name, (event) => {
      down.delete(event.pointerId);
    });
  }
  listen("pointermove", (event) => {
    const point = down.get(event.pointerId);
    if (point === undefined) return;
    const before = { ...point };
    [point.x, point.y] = [event.clientX, event.clientY];
    if (down.size === 2) pinch(navigation, surface, [...down.values()].find((other) => other !== point)!, before, point);
    else if (down.size === 1) drag(navigation, surface, event, point.x - before.x, point.y - before.y);
    moved();
  });
  listen("wheel", (event) => {
    event.preventDefault();
    const pixels = event.deltaMode === WheelEvent.DOM_DELTA_PIXEL ? event.deltaY : 30 * event.deltaY;
    navigation.zoom(Math.exp(Math.max(-200, Math.min(200, pixels)) * WHEEL_STEP));
    moved();
  });
  listen("contextmenu", (event) => {
    event.preventDefault();
  });
  return () => {
    options.abort();
  };
}

function drag(navigation: Navigation, surface: HTMLElement, event: PointerEvent, right: number, downwards: number): void {
  const panning = (event.buttons & 6) !== 0 || event.shiftKey;
  if (panning) {
    const scale = lensPixels(navigation, surface);
    navigation.pan(right * scale, downwards * scale);
  } else if (event.ctrlKey || event.altKey) {
    const turn = TURN_ACROSS / surface.clientWidth / 2;
    navigation.look(-right * turn, -downwards * turn);
  } else {
    const turn = TURN_ACROSS / Math.max(surface.clientWidth, 480);
    navigation.orbit(right * turn, downwards * turn);
  }
}

/** Two fingers: their middle pans, their distance zooms. */
function pinch(navigation: Navigation, surface: HTMLElement, still: Point, before: Point, after: Point): void {
  const distance = (point: Point): number => Math.hypot(point.x - still.x, point.y - still.y);
  if (distance(after) > 8 && distance(before) > 8) navigation.zoom(distance(before) / distance(after));
  const scale = lensPixels(navigation, surface) / 2;
  navigation.pan((after.x - before.x) * scale, (after.y - before.y) * scale);
}

/** Pixels of the lens for one of the page. */
function lensPixels(navigation: Navigation, surface: HTMLElement): number {
  return Math.max(navigation.lens.width / surface.clientWidth, navigation.lens.height / surface.clientHeight);
}
