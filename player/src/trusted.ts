/** What pages with Trusted Types want to be told: that texts and addresses are this script's own, and no stranger's. */

/** The part of the browser's interface that is used here; TypeScript's has none of it yet. */
interface Factory {
  createPolicy(name: string, rules: Record<string, (text: string) => string>): { createHTML(text: string): string; createScriptURL(text: string): string };
}

const { trustedTypes } = globalThis as { readonly trustedTypes?: Factory };
const same = (text: string): string => text;
let policy: ReturnType<Factory["createPolicy"]> | null | undefined;

/** Each script has a policy of its own: names may be given once. Where the page allows none, its browser says what it refuses. */
function ownPolicy(name: string): ReturnType<Factory["createPolicy"]> | null {
  try {
    policy ??= trustedTypes?.createPolicy(name, { createHTML: same, createScriptURL: same }) ?? null;
  } catch {
    policy = null;
  }
  return policy;
}

/** Markup that is written in the sources, `policy`: of another script than the controls'. */
export function ownMarkup(text: string, policy = "decogs-controls"): string {
  return ownPolicy(policy)?.createHTML(text) ?? text;
}

/** The address of a script of this package. */
export function ownScript(address: string): string {
  return ownPolicy("decogs-player")?.createScriptURL(address) ?? address;
}
