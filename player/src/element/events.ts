/** The events that a player sends, with the names that <video> has taught people. */
export type PlayerEvent =
  | "loadstart"
  | "emptied"
  | "loadedmetadata"
  | "loadeddata"
  | "durationchange"
  | "canplay"
  | "play"
  /** Playing has begun, or goes on after it had to wait. */
  | "playing"
  /** The next frame is late. */
  | "waiting"
  /** Nothing comes from the network; it is tried again. */
  | "stalled"
  | "pause"
  | "timeupdate"
  | "seeking"
  | "seeked"
  | "ended"
  | "error"
  | "progress"
  | "ratechange"
  | "volumechange"
  /** A picture of another camera of the rig, or of none: `player.camera`. */
  | "camerachange"
  /** A stream in layers shows another one: `player.info.layer`, 0 the base. */
  | "layerchange"
  /** Somebody looks at the scene in a headset, and looks no longer. */
  | "xrstart"
  | "xrend";
