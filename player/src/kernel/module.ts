/** The kernel's module, compiled once; whoever needs a memory of its own makes an instance. */

import { compiler } from "./fetched";
import source from "./kernel.wasm";

const compile = compiler(source);
let compiling: Promise<WebAssembly.Module> | null = null;
let module: WebAssembly.Module | null = null;

/** Before this has resolved nothing can be read. */
export async function startKernel(): Promise<void> {
  module ??= await (compiling ??= compile());
}

export function kernelInstance(): WebAssembly.Exports {
  if (module === null) {
    if (typeof source === "string") throw new Error("the kernel has not come yet");
    module = new WebAssembly.Module(source);
  }
  return new WebAssembly.Instance(module).exports;
}
