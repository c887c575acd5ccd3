/** The pass of recorded pictures is a script of its own, which comes when one is asked for. */
import type { RecordedPass } from "./recorded_pass";

let pass: typeof RecordedPass | null = null;

/** Until this has resolved, cameras of the rig show what their pinholes do. */
export async function startRecorded(): Promise<void> {
  pass ??= (await import("./recorded_pass")).RecordedPass;
}

export function recordedPass(): typeof RecordedPass | null {
  return pass;
}
