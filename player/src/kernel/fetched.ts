/** WebAssembly that lies beside the script, asked for when the script starts: beside the stream's first request. */

export interface Fetched {
  readonly name: string;
  readonly answer: Promise<Response>;
}

export function fetched(name: string): Fetched {
  const answer = fetch(new URL(name, import.meta.url));
  answer.catch(() => undefined); // whoever waits for it is told
  return { name, answer };
}

export async function compiledFrom({ name, answer }: Fetched): Promise<WebAssembly.Module> {
  const response = await answer;
  if (!response.ok) throw new Error(`${name}: HTTP ${response.status}`);
  if (response.headers.get("Content-Type") === "application/wasm") return WebAssembly.compileStreaming(response);
  return WebAssembly.compile(await response.arrayBuffer()); // a server that does not know the type
}
