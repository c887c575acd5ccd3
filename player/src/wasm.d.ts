/** What esbuild makes of a .wasm file: its bytes in the script, or, in the page, the address of a file beside it. */
declare module "*.wasm" {
  const source: Uint8Array<ArrayBuffer> | string;
  export default source;
}
