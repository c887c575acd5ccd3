/** The worker: decodes, packs and sorts, so that the page stays free to draw and to answer. */
import { createStream } from "../stream/index";
import type { FromWorker, ToWorker } from "../messages";
import { StreamWorker } from "./stream_worker";

const scope = self as unknown as {
  postMessage(message: FromWorker, transfer: Transferable[]): void;
  onmessage: ((event: MessageEvent<ToWorker>) => void) | null;
};

let kernelCame: ((message: Extract<ToWorker, { type: "kernel" }>) => void) | null = null;

/** The page has it come: bundlers that take the page's script apart know nothing of what a worker needs. */
function loadKernel(): Promise<ArrayBuffer> {
  return new Promise((given, refused) => {
    kernelCame = ({ bytes, problem }) => {
      if (bytes === null) refused(new Error(problem));
      else given(bytes);
    };
    scope.postMessage({ type: "kernel" }, []);
  });
}

const worker = new StreamWorker(
  createStream,
  (message, transfer = []) => {
    scope.postMessage(message, transfer);
  },
  loadKernel,
);
scope.onmessage = ({ data }) => {
  if (data.type === "kernel") kernelCame?.(data);
  else worker.receive(data);
};
