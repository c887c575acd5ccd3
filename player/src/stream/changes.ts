/** What changed since a frame was given last, over any number of packets. */

export class Changes {
  private parts: Uint32Array[] = [];
  /** Until a first frame was given, and after a keyframe, all counts as changed. */
  private all = true;

  /** Places, each once; null for all. */
  add(places: Uint32Array | null): void {
    if (places === null) this.all = true;
    else if (places.length > 0 && !this.all) this.parts.push(places);
  }

  /** Places below the count that changed since this was asked last, each once; null for all. */
  take(count: number): Uint32Array | null {
    const { all, parts } = this;
    this.all = false;
    this.parts = [];
    if (all) return null;
    return parts.length === 1 ? below(parts[0], count) : union(parts, count);
  }
}

function below(places: Uint32Array, count: number): Uint32Array {
  for (let i = 0; i < places.length; i++) {
    if (places[i] >= count) return places.filter((place) => place < count);
  }
  return places;
}

function union(parts: readonly Uint32Array[], count: number): Uint32Array {
  const marks = new Uint8Array(count);
  let distinct = 0;
  for (const places of parts) {
    for (const place of places) {
      if (place >= count || marks[place]) continue;
      marks[place] = 1;
      distinct++;
    }
  }
  const all = new Uint32Array(distinct);
  for (let place = 0, next = 0; next < distinct; place++) if (marks[place]) all[next++] = place;
  return all;
}
