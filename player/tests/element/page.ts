/** A page as far as the element needs it, in Node: elements that keep what they are given, and pictures that tests have come. */
import { FakeWorker } from "./browser";

class FakeClasses extends Set<string> {
  contains(name: string): boolean {
    return this.has(name);
  }
  remove(name: string): void {
    this.delete(name);
  }
  toggle(name: string, on = !this.has(name)): void {
    if (on) this.add(name);
    else this.delete(name);
  }
}

/** An element; what is looked for in it is there, since markup is only kept. */
export class FakeElement extends EventTarget {
  readonly kept = new Map<string, string>();
  readonly children: FakeElement[] = [];
  readonly classList = new FakeClasses();
  readonly style: Record<string, string> = {};
  readonly #parts = new Map<string, FakeElement>();
  parent: FakeElement | null = null;
  shadowRoot: FakeElement | null = null;
  hidden = false;
  isConnected = false;
  textContent = "";
  innerHTML = "";
  value = "";
  width = 0;
  height = 0;
  clientWidth = 200;
  clientHeight = 150;
  adoptedStyleSheets: unknown[] = [];
  clicks = 0;
  ownerDocument = globalThis.document;

  constructor(readonly name = "") {
    super();
    // Own fields of an element would be taken over as what a page has set.
    for (const key of Object.keys(this)) Object.defineProperty(this, key, { enumerable: false });
  }

  getAttribute(name: string): string | null {
    return this.kept.get(name) ?? null;
  }
  setAttribute(name: string, value: unknown): void {
    this.#change(name, String(value));
  }
  removeAttribute(name: string): void {
    this.#change(name, null);
  }
  hasAttribute(name: string): boolean {
    return this.kept.has(name);
  }
  toggleAttribute(name: string, on: boolean): void {
    if (on) this.setAttribute(name, "");
    else this.removeAttribute(name);
  }
  attachShadow(): FakeElement {
    return (this.shadowRoot = new FakeElement("shadow"));
  }
  append(...children: FakeElement[]): void {
    for (const child of children) {
      child.remove();
      child.parent = this;
    }
    this.children.push(...children);
  }
  prepend(child: FakeElement): void {
    this.append(child);
  }
  appendChild(child: FakeElement): FakeElement {
    this.append(child);
    return child;
  }
  before(...elements: FakeElement[]): void {
    this.parent?.append(...elements);
  }
  replaceChildren(...children: FakeElement[]): void {
    this.children.length = 0;
    this.append(...children);
  }
  remove(): void {
    this.parent?.children.splice(this.parent.children.indexOf(this), 1);
    this.parent = null;
  }
  contains(other: unknown): boolean {
    return this === other || this.children.some((child) => child.contains(other));
  }
  querySelector(selector: string): FakeElement {
    const part = this.#parts.get(selector) ?? new FakeElement(selector);
    this.#parts.set(selector, part);
    return part;
  }
  closest(): this {
    return this;
  }
  getContext(kind: string): unknown {
    return kind === "2d" ? { putImageData: () => undefined } : null;
  }
  getBoundingClientRect(): unknown {
    return { left: 0, top: 0, width: this.clientWidth, height: this.clientHeight };
  }
  click(): void {
    this.clicks++;
  }
  focus(): void {
    this.dispatchEvent(new Event("focus"));
  }

  #change(name: string, value: string | null): void {
    const before = this.getAttribute(name);
    if (value === null) this.kept.delete(name);
    else this.kept.set(name, value);
    const { observedAttributes = [] } = this.constructor as { readonly observedAttributes?: readonly string[] };
    const element = this as { attributeChangedCallback?: (name: string, before: string | null, value: string | null) => void };
    if (observedAttributes.includes(name)) element.attributeChangedCallback?.(name, before, value);
  }
}

/** Tells what tests have it tell. */
export class FakeObserver {
  static last: FakeObserver;
  observed: unknown[] = [];
  constructor(readonly tell: (entries: readonly { readonly isIntersecting: boolean }[]) => void) {
    FakeObserver.last = this;
  }
  observe(element: unknown): void {
    this.observed.push(element);
  }
  disconnect(): void {
    this.observed = [];
  }
}

/** Pictures that are waited for, by the window's number of each. */
export const waiting = new Map<number, (now: number) => void>();
let requests = 0;

export const fakeWindow = {
  requestAnimationFrame: (callback: (now: number) => void): number => {
    waiting.set(++requests, callback);
    return requests;
  },
  cancelAnimationFrame: (request: number): void => {
    waiting.delete(request);
  },
};

/** The next picture comes. */
export function picture(now: number): void {
  const callbacks = [...waiting.values()];
  waiting.clear();
  for (const callback of callbacks) callback(now);
}

export const page = Object.assign(new EventTarget(), {
  hidden: false,
  baseURI: "http://localhost/page/",
  fullscreenElement: null,
  defaultView: globalThis,
  createElement: (name: string) => new FakeElement(name),
});

/** What a page is told of functions that fail. */
export const reported: unknown[] = [];

class Quiet {
  observe(): void {
    // Sizes never change.
  }
  disconnect(): void {
    // Nothing was observed.
  }
}

Object.assign(globalThis, {
  ...fakeWindow,
  HTMLElement: FakeElement,
  HTMLSelectElement: FakeElement,
  HTMLButtonElement: FakeElement,
  Image: FakeElement,
  Option: class extends FakeElement {
    constructor(text: string, value: string) {
      super("option");
      Object.assign(this, { textContent: text, value });
    }
  },
  IntersectionObserver: FakeObserver,
  ResizeObserver: Quiet,
  CSSStyleSheet: class {
    replaceSync(): void {
      // Nothing is seen.
    }
  },
  ImageData: Quiet,
  Worker: FakeWorker,
  document: page,
  matchMedia: () => Object.assign(new EventTarget(), { matches: false }),
  getComputedStyle: () => ({ color: "" }),
  reportError: (error: unknown) => reported.push(error),
});
