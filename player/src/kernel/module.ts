/**
 * The kernel's module, compiled once; whoever needs a memory of its own makes an instance. In the page it lies beside the
 * script and is compiled while it comes; elsewhere the script has its bytes.
 */

import source from "./kernel.wasm";
import { compiledFrom, fetched } from "./fetched";

const coming = typeof source === "string" ? fetched(source) : null;
let module: WebAssembly.Module | null = null;

/** Before this has resolved nothing can be read. */
export async function startKernel(): Promise<void> {
  if (coming !== null) module ??= await (compiling ??= compiledFrom(coming));
}

let compiling: Promise<WebAssembly.Module> | null = null;

export function kernelInstance(): WebAssembly.Exports {
  if (module === null) {
    if (typeof source === "string") throw new Error("the kernel has not come yet");
    module = new WebAssembly.Module(source);
  }
  return new WebAssembly.Instance(module).exports;
}
