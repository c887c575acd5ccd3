/** What the page's build makes of a .css file: a text, without what is there for readers only. */
declare module "*.css" {
  const text: string;
  export default text;
}

/** What esbuild makes of a .wasm file: its bytes in the script, or, in the page, the address of a file beside it. */
declare module "*.wasm" {
  const source: Uint8Array<ArrayBuffer> | string;
  export default source;
}
