/** Which frame changed each Gaussian last, for viewers that show it: by slots, so that it holds after a seek, too. */

export class Ages {
  /** By slot, the frame; that of the keyframe where nothing came after it. Longer than there are Gaussians. */
  frames = new Int32Array(0);

  /** Notes that a frame changed slots; null for all. */
  note(frame: number, slots: Uint32Array | null, count: number): void {
    if (this.frames.length < count) {
      const longer = new Int32Array(Math.ceil(count * 1.25));
      longer.set(this.frames);
      this.frames = longer;
    }
    if (slots === null) this.frames.fill(frame, 0, count);
    else for (let i = 0; i < slots.length; i++) this.frames[slots[i]] = frame;
  }
}
