/** Which Gaussians are drawn where only a share of them is to be: those of the largest width times opacity (DESIGN.md, "Quality"). */
import type { SceneFrame } from "../scene";

const BINS = 4096;

export class Detail {
  private wanted = 1;
  private kept = new Uint8Array(0);
  /** Of the segment that `kept` was chosen in. */
  private chosen = -1;

  set share(share: number) {
    this.wanted = share;
    this.chosen = -1;
  }

  /** Leaves in `order` what is drawn of its first `count` slots; how many these are. Chosen once a segment. */
  thin(scene: SceneFrame, order: Uint32Array, count: number): number {
    if (this.wanted >= 1) return count;
    const { kind, frame } = scene;
    if (this.chosen < 0 || kind === "key" || frame < this.chosen) this.choose(scene);
    const { kept } = this;
    let left = 0;
    for (let at = 0; at < count; at++) {
      const slot = order[at];
      if (slot >= kept.length || kept[slot] === 1) order[left++] = slot;
    }
    return left;
  }

  private choose({ frame, gaussians }: SceneFrame): void {
    const { count, logScales, opacityLogits } = gaussians;
    const weights = new Float32Array(count);
    let [low, high] = [Infinity, -Infinity];
    for (let slot = 0; slot < count; slot++) {
      const [a, b, c] = [logScales[3 * slot], logScales[3 * slot + 1], logScales[3 * slot + 2]];
      const weight = (a + b + c - Math.min(a, b, c)) / 2 - Math.log1p(Math.exp(-opacityLogits[slot]));
      weights[slot] = weight;
      if (weight < low) low = weight;
      if (weight > high) high = weight;
    }
    const scale = (BINS - 1) / Math.max(high - low, 1e-9);
    const bins = new Uint32Array(BINS);
    for (const weight of weights) bins[Math.floor((weight - low) * scale)]++;
    let [least, above] = [BINS, 0];
    while (least > 0 && above < this.wanted * count) above += bins[--least];
    this.kept = Uint8Array.from(weights, (weight) => Number(Math.floor((weight - low) * scale) >= least));
    this.chosen = frame;
  }
}
