/** WebAssembly that lies beside the script, asked for when the script starts: beside the stream's first request. */

export interface Fetched {
  readonly address: string;
  readonly answer: Promise<Response>;
}

export function fetched(name: string): Fetched {
  const { href: address } = new URL(name, import.meta.url);
  const answer = fetch(address);
  answer.catch(() => undefined); // whoever waits for it is told
  return { address, answer };
}

export async function compiledFrom({ address, answer }: Fetched): Promise<WebAssembly.Module> {
  const response = await answer;
  if (!response.ok) throw new Error(`${address}: HTTP ${response.status}`);
  if (response.headers.get("Content-Type") === "application/wasm") return WebAssembly.compileStreaming(response);
  return WebAssembly.compile(await response.arrayBuffer()); // a server that does not know the type
}
