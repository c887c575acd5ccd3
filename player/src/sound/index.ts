/** A script of its own, which comes with the first stream that has sound. */
export { Speaker } from "./speaker";
