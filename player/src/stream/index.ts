export { createStream, type StreamOptions } from "./sceneStream";
export { StreamError, type Reason } from "../container/errors";
export type { ByteSource } from "./sources";
