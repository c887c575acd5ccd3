/** The events that a player sends, with the names that <video> has taught people. */
export type PlayerEvent =
  | "loadedmetadata"
  | "loadeddata"
  | "durationchange"
  | "play"
  | "pause"
  | "timeupdate"
  | "seeking"
  | "seeked"
  | "ended"
  | "error"
  | "progress"
  | "ratechange"
  /** A picture of another camera of the rig, or of none: `player.camera`. */
  | "camerachange";
