/** The exact picture's kernel as bytes, for the worker: of a file beside this script; in the package, of a script. */
import { fetched } from "../kernel/fetched";

/** Rejects with why they cannot be had; may be asked again. */
export async function kernelBytes(): Promise<ArrayBuffer> {
  const { default: source } = await import("./exact.wasm");
  return typeof source === "string" ? (await fetched(source)).arrayBuffer() : source.slice().buffer;
}
