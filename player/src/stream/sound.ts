/** The sound of a frame: packets behind its own. */
import type { Limits } from "../container/limits";
import { KIND } from "../container/packets";
import { MAX_PACKETS, readSoundPacket } from "../container/sound";
import type { SoundFrame, SoundPacket } from "../scene";
import { findBeside } from "./framePackets";
import type { FrameTable } from "./frameTable";
import type { ByteSource } from "./sources";

export async function readSound(source: ByteSource, table: FrameTable, frame: number, tracks: number, limits: Limits): Promise<SoundFrame> {
  const packets: SoundPacket[] = [];
  let count = 0;
  await findBeside(source, table, frame, limits, (header, payload) => {
    if (header.kind !== KIND.SOUND || header.frame !== frame || ++count > MAX_PACKETS) return;
    const packet = readSoundPacket(payload, tracks);
    if (packet !== null) packets.push(packet);
  });
  return { frame, packets };
}
