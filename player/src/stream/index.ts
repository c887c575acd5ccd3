export { createStream, type StreamOptions, type StreamSource } from "./sceneStream";
export { StreamError, type Reason } from "../container/errors";
export type { ByteSource } from "./sources";
