/** null: it is no address, or it is relative in a page that has none itself. */
export function absolute(address: string): string | null {
  try {
    return new URL(address, document.baseURI).href;
  } catch {
    return null;
  }
}
