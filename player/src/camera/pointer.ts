/** Mouse, pen and touch: one pointer circles, two pan and zoom; right, middle or with shift a mouse pans; the wheel zooms. */
import type { Navigation } from "./navigation";

/** Radians that a drag across the whole picture turns by. */
const TURN_ACROSS = Math.PI * 1.1;
const WHEEL_STEP = 0.0012;

interface Point {
  x: number;
  y: number;
}

export interface PointerHost {
  /** Told of every movement. */
  readonly cameraMoved: () => void;
  /** Whether one finger and the wheel are the page's: it scrolls. */
  readonly cooperative: () => boolean;
  readonly hint: (text: string) => void;
}

/** Listens until the function that it returns is called. */
export function attachPointer(surface: HTMLElement, navigation: Navigation, { cameraMoved, cooperative, hint }: PointerHost): () => void {
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
    if (down.size === 2) {
      const other = [...down.values()].find((each) => each !== point)!;
      pinch(navigation, surface, other, before, point, cooperative());
    } else if (event.pointerType === "touch" && cooperative()) {
      hint("Use two fingers to look around");
      return;
    } else if (down.size === 1) drag(navigation, surface, event, point.x - before.x, point.y - before.y);
    cameraMoved();
  });
  // Two fingers are not for scrolling.
  for (const name of ["touchstart", "touchmove"] as const) {
    listen(name, (event) => {
      if (event.touches.length > 1 && event.cancelable) event.preventDefault();
    });
  }
  listen("wheel", (event) => {
    if (cooperative() && !event.ctrlKey && !event.metaKey) {
      hint("Use Ctrl and the wheel to go nearer");
      return;
    }
    event.preventDefault();
    const pixels = event.deltaMode === WheelEvent.DOM_DELTA_PIXEL ? event.deltaY : 30 * event.deltaY;
    navigation.zoom(Math.exp(Math.max(-200, Math.min(200, pixels)) * WHEEL_STEP));
    cameraMoved();
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
    const turn = turnOf(surface);
    navigation.orbit(right * turn, downwards * turn);
  }
}

/** Two fingers: their distance zooms, their middle pans, or circles where one finger may not. */
function pinch(
  navigation: Navigation,
  surface: HTMLElement,
  still: Point,
  before: Point,
  after: Point,
  circles: boolean,
): void {
  const distance = (point: Point): number => Math.hypot(point.x - still.x, point.y - still.y);
  if (distance(after) > 8 && distance(before) > 8) navigation.zoom(distance(before) / distance(after));
  const [right, downwards] = [(after.x - before.x) / 2, (after.y - before.y) / 2];
  if (circles) {
    const turn = turnOf(surface);
    navigation.orbit(right * turn, downwards * turn);
    return;
  }
  const scale = lensPixels(navigation, surface);
  navigation.pan(right * scale, downwards * scale);
}

/** Radians of a circling movement for a pixel of the page. */
function turnOf(surface: HTMLElement): number {
  return TURN_ACROSS / Math.max(surface.clientWidth, 480);
}

/** Pixels of the lens for one of the page. */
function lensPixels(navigation: Navigation, surface: HTMLElement): number {
  return Math.max(navigation.lens.width / surface.clientWidth, navigation.lens.height / surface.clientHeight);
}
