/** The map of where viewers may stand, from where an attribute says that it lies. */
import { Fence } from "../camera/fence";

export class FenceFile {
  #address = "";

  constructor(
    private readonly came: (fence: Fence | null) => void,
    private readonly failed: (why: string) => void,
  ) {}

  /** Empty: there is none. */
  set address(address: string) {
    this.#address = address;
    this.came(null);
    if (address !== "") void this.#read(address);
  }

  async #read(address: string): Promise<void> {
    try {
      const answer = await fetch(address);
      if (!answer.ok) throw new Error(`HTTP ${answer.status}`);
      const fence = Fence.of(await answer.json());
      if (address === this.#address) this.came(fence);
    } catch (error) {
      this.failed(`fence ${address}: ${error instanceof Error ? error.message : String(error)}; views stay where the rig's cameras stood`);
    }
  }
}
