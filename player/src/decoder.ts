/** The decoder alone, for viewers of others and for Node: frames of a stream, from an address, a file or bytes. */
export { createFrameSource, type FrameSource } from "./export/frame_source";
export type { SplatElement, SplatProperty } from "./export/elements";
export { createStream, StreamError, type ByteSource, type Reason, type StreamOptions, type StreamSource } from "./stream/index";
export type { FrameEntry, Gaussians, RigCamera, SceneFrame, SceneStream, StreamHeader } from "./scene";
