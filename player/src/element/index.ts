/** Makes `<decogs-player>` known to the page, where there is one: servers evaluate the modules of a page, too. */
import { DecogsPlayer } from "./player";

if ("customElements" in globalThis && customElements.get("decogs-player") === undefined) customElements.define("decogs-player", DecogsPlayer);

export { DecogsPlayer };
export type { PlayerEvent } from "./events";
export type { Figures, FrameList, Overlay, Place, PlayerApi, Span, View } from "../player_api";
export { cameraFromLink, cameraToLink, poseFile } from "../controls/camera_text";

declare global {
  interface HTMLElementTagNameMap {
    "decogs-player": DecogsPlayer;
  }
}
