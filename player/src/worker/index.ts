/** The worker: decodes, packs and sorts, so that the page stays free to draw and to answer. */
import { createStream } from "../stream/index";
import type { FromWorker, ToWorker } from "../messages";
import { StreamWorker, type OpenStream } from "./stream_worker";

const scope = self as unknown as {
  postMessage(message: FromWorker, transfer: Transferable[]): void;
  onmessage: ((event: MessageEvent<ToWorker>) => void) | null;
};

const open: OpenStream = async (source, options) =>
  createStream(await (await fetch(source)).arrayBuffer(), options);

const worker = new StreamWorker(open, (message, transfer = []) => {
  scope.postMessage(message, transfer);
});
scope.onmessage = (event) => {
  worker.receive(event.data);
};
