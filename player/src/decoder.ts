/** The decoder alone, for viewers of others and for Node: frames of a stream, from an address, a file or bytes. */
export { createFrameSource, type FrameSource, type SplatElement, type SplatProperty } from "./frame_source";
export { createStream, StreamError, type ByteSource, type Reason, type StreamOptions, type StreamSource } from "./stream/index";
export type { FrameEntry, Gaussians, RigCamera, SceneFrame, SceneStream, StreamHeader } from "./scene";
