/** Answers the page's messages from an open stream. Knows no browser, so that tests drive it in Node. */
import type { PinholeCamera } from "../geometry/camera";
import type { SceneFrame, SceneStream } from "../scene";
import { FRAME_KINDS, TEXTURE_WIDTH, textureLines, type Budget, type DepthRow, type DrawOrder, type ExactPicture, type FrameInfo, type FrameTable, type FromWorker, type Opening, type SceneUpdate, type ToWorker } from "../messages";
import type { ExactRenderer } from "../exact/renderer";
import { Buffers } from "./buffers";
import { Detail } from "./detail";
import { DepthSorter } from "./depth_order";
import type { plyOf } from "../export/ply";
import type { StreamOptions } from "../stream/sceneStream";
import type { ExactPictures, LoadKernel } from "./exact_pictures";
import { PackedScene } from "./packed_scene";
import { textureLayout } from "./packing";

export type OpenStream = (source: string, options: StreamOptions) => Promise<SceneStream>;
type PlyMaker = typeof plyOf;
export type Send = (message: FromWorker, transfer?: Transferable[]) => void;

const PROGRESS_MS = 100;
/** After which a frame is taken to stay. */
const STAYS_MS = 150;
const EMPTY_ORDER: DrawOrder = { order: new Uint32Array(0), count: 0, sortMs: 0, serial: 0 };

export class StreamWorker {
  private stream: SceneStream | null = null;
  private packed: PackedScene | null = null;
  private frame: SceneFrame | null = null;
  private view: { readonly depth: DepthRow; readonly serial: number } | null = null;
  private readonly buffers = new Buffers();
  /** A script of its own, which comes with the first exact picture. */
  private exact: ExactPictures | null = null;
  private kernel: ExactRenderer | null = null;
  private exactCamera: PinholeCamera | null = null;
  /** What makes a .ply, while one is asked for. */
  private plyMaker: PlyMaker | null = null;
  private readonly sorter = new DepthSorter();
  private readonly detail = new Detail();
  private sent = { frames: 0, metrics: 0, state: "" };
  private progressTimer: ReturnType<typeof setTimeout> | null = null;
  /** The frame that is read or decoded; null when none is. */
  private awaited: number | null = null;
  private wanted: { frame: number; request: number } | null = null;
  private abort: AbortController | null = null;
  private busy = false;
  private sortDue = false;
  private follow = false;
  private sparing = false;
  private budget: Budget = {};

  constructor(
    private readonly openStream: OpenStream,
    private readonly send: Send,
    private readonly loadKernel: LoadKernel,
  ) {}

  receive(message: Exclude<ToWorker, { type: "kernel" }>): void {
    switch (message.type) {
      case "open":
        if (message.first !== null) this.wanted = { frame: message.first, request: 0 };
        void this.open(message);
        return;
      case "show":
        this.wanted = message;
        // A frame still on its way that is not the one before is of no use any more.
        if (this.frame !== null && this.abort !== null && message.frame < this.frame.frame) this.abort.abort();
        void this.showWanted();
        return;
      case "view":
        this.view = message;
        this.sortSoon();
        return;
      case "detail":
        this.detail.share = message.share;
        this.sortSoon();
        return;
      case "budget":
        this.budget = message.budget;
        this.stream?.keepWithin(this.budget);
        return;
      case "refresh":
        void this.refresh();
        return;
      case "resend":
        this.resend();
        return;
      case "recycle":
        this.buffers.giveBack(message.buffers);
        return;
      case "exact":
        void this.drawExactly(message.camera);
        return;
      case "still":
        void this.drawStill(message.frame, message.camera);
        return;
      case "ply":
        void this.givePly();
        return;
      case "sound":
        void this.giveSound(message.from, message.to, message.request);
        return;
      case "close":
        this.abort?.abort();
        this.stream?.close();
        this.stream = null;
    }
  }

  private async open({ source, follow, sparing = false, credentials }: Opening): Promise<void> {
    try {
      const onChange = (): void => {
        this.tellSoon();
      };
      const stream = await this.openStream(source, { follow, ahead: !sparing, onChange, ...(credentials && { credentials }) });
      const { header } = stream;
      this.follow = follow;
      this.sparing = sparing;
      const complete = this.isComplete(stream);
      const layout = textureLayout(header.shDegree);
      this.stream = stream;
      stream.keepWithin(this.budget);
      this.packed = new PackedScene(layout, this.buffers);
      const frames = this.newFrames() ?? { from: 0, kinds: new Uint8Array(0), bytes: new Uint32Array(0) };
      this.send({ type: "opened", header, layout, frames, complete });
      this.tellProgress();
      void this.showWanted();
    } catch (error) {
      const message = sentence(error);
      this.send({ type: "failed", request: null, message: message.includes("://") ? message : `${source}: ${message}` });
    }
  }

  /** Shows the frame asked for last, one at a time: what was asked for meanwhile and is no longer wanted is skipped. */
  private async showWanted(): Promise<void> {
    const { stream, packed } = this;
    if (this.busy || stream === null || packed === null) return;
    this.busy = true;
    while (this.wanted !== null) {
      const { frame, request } = this.wanted;
      this.wanted = null;
      this.awaited = frame;
      this.abort = new AbortController();
      try {
        const begun = performance.now();
        const scene = await stream.frame(frame, this.abort.signal);
        this.awaited = null;
        const decoded = performance.now();
        const update = packed.take(scene);
        const packedAt = performance.now();
        this.frame = scene;
        const draw = this.sorted();
        const info = infoOf(scene, decoded - begun, packedAt - decoded);
        this.send({ type: "frame", request, info, update, draw }, transfers(draw, update));
        this.tellProgress();
        if (request > 0 || !this.sparing) void this.prefetch(stream, frame + 1);
        if (scene.layer === 0) this.refineSoon(stream, scene);
      } catch (error) {
        if (request === 0 && frame >= stream.frames.length) this.send({ type: "notYet" });
        else if (!this.abort.signal.aborted) this.send({ type: "failed", request, message: sentence(error) });
      }
      this.answerHeld();
    }
    this.awaited = null;
    this.busy = false;
  }

  /** A frame that stays in the picture gets what refines it. */
  private refineSoon(stream: SceneStream, scene: SceneFrame): void {
    if (stream.header.layers.length === 0) return;
    const stays = (): boolean => this.stream === stream && this.frame === scene && this.wanted === null;
    setTimeout(() => {
      if (!stays()) return;
      stream.refine(scene.frame).then((any) => {
        if (any && stays()) void this.showRefined(stream, scene.frame);
      }, () => undefined); // the base is there
    }, STAYS_MS);
  }

  private async showRefined(stream: SceneStream, frame: number): Promise<void> {
    if (this.busy || this.packed === null) return;
    this.busy = true;
    try {
      const scene = await stream.frame(frame);
      const update = this.packed.take(scene);
      this.frame = scene;
      const draw = this.sorted();
      this.send({ type: "frame", request: -1, info: infoOf(scene, 0, 0), update, draw }, transfers(draw, update));
    } catch {
      // The frame itself has been shown.
    }
    this.busy = false;
    this.answerHeld();
    void this.showWanted();
  }

  private async prefetch(stream: SceneStream, from: number): Promise<void> {
    try {
      await stream.prefetch(from);
      this.tellProgress();
    } catch {
      // The frame itself will say what is wrong, when it is due.
    }
  }

  private async giveSound(from: number, to: number, request: number): Promise<void> {
    try {
      const frames = (await this.stream?.sound(from, to)) ?? [];
      this.send({ type: "sound", request, frames });
    } catch {
      // The frame itself will say what is wrong, when it is due.
    }
  }

  private async refresh(): Promise<void> {
    let grown = false;
    try {
      grown = (await this.stream?.refresh()) ?? false;
    } catch (error) {
      this.send({ type: "failed", request: null, message: sentence(error) });
    }
    this.tellProgress();
    this.send({ type: "refreshed", grown });
  }

  private resend(): void {
    if (this.frame === null || this.packed === null) return;
    const update = this.packed.whole();
    const draw = this.sorted();
    const info = infoOf(this.frame, 0, 0);
    this.send({ type: "frame", request: -1, info, update, draw }, transfers(draw, update));
  }

  /** Between two frames only: while one is decoded, the scene is neither this nor that. */
  private async drawExactly(camera: PinholeCamera): Promise<void> {
    try {
      await this.startKernel();
    } catch (error) {
      this.send({ type: "exact", picture: null, problem: sentence(error), kernel: false });
      return;
    }
    this.exactCamera = camera;
    if (!this.busy) this.answerHeld();
  }

  private async startKernel(): Promise<{ readonly exact: ExactPictures; readonly kernel: ExactRenderer }> {
    const { ExactPictures } = await import("./exact_pictures");
    const exact = (this.exact ??= new ExactPictures(this.loadKernel));
    const kernel = (this.kernel = await exact.ready());
    return { exact, kernel };
  }

  private async drawStill(frame: number, camera: PinholeCamera): Promise<void> {
    let picture: ExactPicture | null = null;
    try {
      const { exact, kernel } = await this.startKernel();
      const { stream } = this;
      if (stream !== null) picture = exact.draw(kernel, (await stream.keyframe(frame)).gaussians, stream.header, camera);
    } catch {
      // A picture on the timeline is not worth a word; the frame itself will say what is wrong.
    }
    this.send({ type: "still", picture }, picture === null ? [] : [picture.pixels.buffer]);
  }

  private async givePly(): Promise<void> {
    try {
      this.plyMaker = (await import("../export/ply")).plyOf;
      if (!this.busy) this.answerHeld();
    } catch (error) {
      this.send({ type: "ply", bytes: null, problem: sentence(error) });
    }
  }

  /** What was asked for while a frame was decoded. */
  private answerHeld(): void {
    this.drawHeld();
    const { plyMaker, frame, stream } = this;
    if (plyMaker === null || frame === null || stream === null) return;
    this.plyMaker = null;
    const bytes = plyMaker(frame.gaussians, stream.header);
    this.send({ type: "ply", bytes, problem: "" }, [bytes.buffer]);
  }

  private drawHeld(): void {
    const { exact, kernel, exactCamera: camera } = this;
    if (exact === null || kernel === null || camera === null) return;
    this.exactCamera = null;
    try {
      const header = this.stream?.header;
      const picture =
        this.frame === null || header === undefined
          ? null
          : exact.draw(kernel, this.frame.gaussians, header, camera);
      this.send({ type: "exact", picture, problem: null, kernel: true }, picture === null ? [] : [picture.pixels.buffer]);
    } catch (error) {
      this.send({ type: "exact", picture: null, problem: sentence(error), kernel: true });
    }
  }

  /** Sorts after the messages that have come already: of several views only the last counts. */
  private sortSoon(): void {
    if (this.sortDue) return;
    this.sortDue = true;
    setTimeout(() => {
      this.sortDue = false;
      if (this.frame === null) return;
      const draw = this.sorted();
      if (draw === EMPTY_ORDER) return;
      this.send({ type: "order", draw }, transfers(draw, null));
    });
  }

  private sorted(): DrawOrder {
    if (this.frame === null || this.view === null) return EMPTY_ORDER;
    const begun = performance.now();
    const { means, count } = this.frame.gaussians;
    const order = this.buffers.words(TEXTURE_WIDTH * textureLines(count, 1));
    const drawn = this.detail.thin(this.frame, order, this.sorter.sort(means, count, this.view.depth, order));
    return { order, count: drawn, sortMs: performance.now() - begun, serial: this.view.serial };
  }

  /** Bytes come in many small pieces. */
  private tellSoon(): void {
    this.progressTimer ??= setTimeout(() => {
      this.tellProgress();
    }, PROGRESS_MS);
  }

  private tellProgress(): void {
    if (this.progressTimer !== null) clearTimeout(this.progressTimer);
    this.progressTimer = null;
    const { stream, sent, awaited } = this;
    if (stream === null) return;
    const psnr = this.newMetrics(stream);
    const frames = this.newFrames();
    const { bytesRead, notices, buffered, refined, trouble } = stream;
    const share = awaited === null ? null : stream.share(awaited);
    const state = { bytesRead, notices, buffered, refined, trouble, share, complete: this.isComplete(stream) };
    const text = JSON.stringify(state);
    if (frames === null && psnr.length === 0 && text === sent.state) return;
    sent.state = text;
    this.send({ type: "progress", frames, psnr, ...state });
  }

  /** Whether no more frames will come. */
  private isComplete(stream: SceneStream): boolean {
    return stream.complete || (stream.waits && !this.follow);
  }

  private newFrames(): FrameTable | null {
    const frames = this.stream!.frames;
    const from = this.sent.frames;
    if (frames.length <= from) return null;
    const added = frames.slice(from);
    this.sent.frames = frames.length;
    const kinds = Uint8Array.from(added, ({ kind }) => FRAME_KINDS.indexOf(kind));
    return { from, kinds, bytes: Uint32Array.from(added, ({ bytes }) => bytes) };
  }

  private newMetrics(stream: SceneStream): readonly (readonly [number, number])[] {
    if (stream.metrics.size === this.sent.metrics) return [];
    const added = [...stream.metrics].slice(this.sent.metrics); // a Map keeps the order in which entries came
    this.sent.metrics = stream.metrics.size;
    return added.flatMap(([frame, { psnr }]) => (psnr === null ? [] : [[frame, psnr] as const]));
  }
}

function infoOf(scene: SceneFrame, decodeMs: number, packMs: number): FrameInfo {
  const { frame, kind, bytes, layer, damage, changed, added, removed, corrections } = scene;
  const { count } = scene.gaussians;
  return { frame, kind, bytes, layer, damage, count, changed, added, removed, decodeMs, packMs, corrections };
}

function transfers(draw: DrawOrder, update: SceneUpdate | null): Transferable[] {
  const buffers = new Set<ArrayBufferLike>();
  if (draw !== EMPTY_ORDER) buffers.add(draw.order.buffer);
  if (update !== null) {
    for (const array of [update.part?.slots, update.base, update.rest, update.heat]) {
      if (array) buffers.add(array.buffer);
    }
  }
  return [...buffers] as ArrayBuffer[];
}

function sentence(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}
