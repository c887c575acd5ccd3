/** The worker: decodes, packs and sorts, so that the page stays free to draw and to answer. */
import { createStream } from "../stream/index";
import type { FromWorker, ToWorker } from "../messages";
import { StreamWorker } from "./stream_worker";

const scope = self as unknown as {
  postMessage(message: FromWorker, transfer: Transferable[]): void;
  onmessage: ((event: MessageEvent<ToWorker>) => void) | null;
};

/** It lies beside this script. */
const loadKernel = async (): Promise<ArrayBuffer> => {
  const { href } = new URL("./decogs-exact.wasm", import.meta.url);
  const answer = await fetch(href);
  if (!answer.ok) throw new Error(`${href}: HTTP ${answer.status}`);
  return answer.arrayBuffer();
};

const worker = new StreamWorker(
  createStream,
  (message, transfer = []) => {
    scope.postMessage(message, transfer);
  },
  loadKernel,
);
scope.onmessage = (event) => {
  worker.receive(event.data);
};
