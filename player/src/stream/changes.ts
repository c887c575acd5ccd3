/** What changed since a frame was given last, over any number of packets. */

export class Changes {
  private parts: Uint32Array[] = [];
  /** Until a first frame was given, and after a keyframe, all counts as changed. */
  private all = true;

  /** Slots, each once; null for all. */
  add(slots: Uint32Array | null): void {
    if (slots === null) this.all = true;
    else if (slots.length > 0 && !this.all) this.parts.push(slots);
  }

  /** Slots below the count that changed since this was asked last, each once; null for all. */
  take(count: number): Uint32Array | null {
    const { all, parts } = this;
    this.all = false;
    this.parts = [];
    if (all) return null;
    return parts.length === 1 ? below(parts[0], count) : union(parts, count);
  }
}

function below(slots: Uint32Array, count: number): Uint32Array {
  for (let i = 0; i < slots.length; i++) {
    if (slots[i] >= count) return slots.filter((slot) => slot < count);
  }
  return slots;
}

function union(parts: readonly Uint32Array[], count: number): Uint32Array {
  const marks = new Uint8Array(count);
  let distinct = 0;
  for (const slots of parts) {
    for (const slot of slots) {
      if (slot >= count || marks[slot]) continue;
      marks[slot] = 1;
      distinct++;
    }
  }
  const all = new Uint32Array(distinct);
  for (let slot = 0, next = 0; next < distinct; slot++) if (marks[slot]) all[next++] = slot;
  return all;
}
