/** Style sheets that are no elements, which a page's Content-Security-Policy may forbid. */

/** What a root has adopted; scripts that are bundled apart add to it. */
const TEXTS: unique symbol = Symbol.for("decogs.styles");
type Styled = ShadowRoot & { [TEXTS]?: readonly string[] };

export function adopt(root: Styled, text: string): void {
  root[TEXTS] = [...(root[TEXTS] ?? []), text];
  add(root, text);
}

/** Another document forgets what the one before had adopted. */
export function adoptAgain(root: Styled): void {
  for (const text of root[TEXTS] ?? []) add(root, text);
}

function add(root: ShadowRoot, text: string): void {
  const sheet = new (root.ownerDocument.defaultView ?? globalThis).CSSStyleSheet();
  sheet.replaceSync(text);
  root.adoptedStyleSheets.push(sheet);
}
