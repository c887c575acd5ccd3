/** WebAssembly: its bytes in the script, as in the package, or the name of a file beside it, as in the page. */

/** The answer for a file beside this script; rejects, naming its address, where it is not there. */
export async function fetched(name: string): Promise<Response> {
  const { href } = new URL(name, import.meta.url);
  const response = await fetch(href);
  if (!response.ok) throw new Error(`${href}: HTTP ${response.status}`);
  return response;
}

/** What compiles it. A file is asked for at once, beside the stream's first request. */
export function compiler(source: Uint8Array<ArrayBuffer> | string): () => Promise<WebAssembly.Module> {
  const answer = typeof source === "string" ? fetched(source) : null;
  answer?.catch(() => undefined); // whoever has it compiled is told
  return async () => {
    if (!("WebAssembly" in globalThis)) throw new Error("there is no WebAssembly here, without which no stream is read");
    if (typeof source !== "string") return WebAssembly.compile(source);
    const response = await answer!;
    if (response.headers.get("Content-Type") === "application/wasm") return WebAssembly.compileStreaming(response);
    return WebAssembly.compile(await response.arrayBuffer()); // a server that does not know the type
  };
}
