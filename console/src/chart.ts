import uPlot from "uplot";
import { button, h } from "./dom.ts";
import { t } from "./i18n.ts";
import { HISTORY_S, type Recording } from "./recording.ts";
import { Span } from "./span.ts";

/** How often a plot steps where the person has asked their system for less motion. */
const CALM_MS = 1000;

const COLORS = ["#3b82f6", "#e5484d", "#30a46c", "#f59e0b", "#a855f7", "#0ea5e9", "#ec4899", "#84cc16"];

const USUAL_S = 60;
const SHORTEST_S = 0.5;

/** Of a press of the buttons that zoom and shift. */
const ZOOM = 2;
const SHIFT_SHARE = 0.25;

/** A plot of a recording that can be stopped, zoomed, shifted and saved: by its buttons, by a mouse
 * that marks a stretch, by one finger that drags and two that spread. */
export class Chart {
  readonly element: HTMLElement;
  private readonly place = h("div", { class: "plot" });
  private readonly bar: HTMLElement;
  private readonly pause: HTMLButtonElement;
  private readonly span = new Span(USUAL_S, SHORTEST_S, HISTORY_S);
  private readonly calm = matchMedia("(prefers-reduced-motion: reduce)");
  private drawnMs = -Infinity;
  private plot: uPlot | null = null;
  private recording: Recording | null = null;
  private name = "";
  private title = "";
  private fingers = new Map<number, number>();

  /** `beside`: what stands before its buttons. */
  constructor(...beside: HTMLElement[]) {
    this.pause = button(t("pause"), () => this.setPaused(!this.span.stands));
    const small = (label: string, word: "zoomIn" | "zoomOut" | "earlier" | "later", press: () => void) =>
      button(label, press, { class: "small", "aria-label": t(word), title: t(word) });
    this.bar = h(
      "div",
      { class: "row" },
      this.pause,
      small("−", "zoomOut", () => this.zoom(ZOOM)),
      small("+", "zoomIn", () => this.zoom(1 / ZOOM)),
      small("◀", "earlier", () => this.shift(-SHIFT_SHARE)),
      small("▶", "later", () => this.shift(SHIFT_SHARE)),
      button(t("csv"), () => this.saveCsv()),
      button(t("picture"), () => this.savePicture()),
    );
    this.element = h("div", { class: "chart" }, ...beside, this.place, this.bar);
    new ResizeObserver(() => this.fit()).observe(this.place);
    this.touches();
  }

  /** Show another recording; `name` is that of its files. */
  show(recording: Recording | null, name: string, title: string): void {
    [this.recording, this.name, this.title] = [recording, name, title];
    this.plot?.destroy();
    this.plot = null;
    if (recording) this.build(recording);
    this.setPaused(false);
  }

  /** Bring it up to date. */
  draw(): void {
    if (this.span.stands || this.element.offsetParent === null) return;
    const nowMs = performance.now();
    if (this.calm.matches && nowMs - this.drawnMs < CALM_MS) return;
    this.drawnMs = nowMs;
    this.redraw();
  }

  private build(recording: Recording): void {
    const { color: ink, borderTopColor: line } = getComputedStyle(this.place);
    const axis: uPlot.Axis = { stroke: ink, grid: { stroke: line, width: 1 }, ticks: { show: false } };
    const seconds = (_plot: uPlot, all: number[]) =>
      all.map((each) => `${Number(each.toFixed(2))} s`);
    this.plot = new uPlot(
      {
        ...this.size(),
        scales: { x: { time: false, range: () => this.range() } },
        axes: [{ ...axis, values: seconds }, axis],
        cursor: { drag: { setScale: false }, bind: { dblclick: () => () => this.follow() } },
        hooks: { setSelect: [(plot) => this.marked(plot)] },
        series: [
          { label: "s", value: (_plot, value) => (value === null ? "–" : value.toFixed(2)) },
          ...recording.names.map((label, index) => ({
            label,
            stroke: COLORS[index % COLORS.length] ?? ink,
            width: 1.75,
            value: (_plot: uPlot, value: number | null) => (value === null ? "–" : value.toFixed(2)),
          })),
        ],
      },
      recording.data(),
      this.place,
    );
  }

  private range(): [number, number] {
    const { oldest, newest } = this.recording ?? { oldest: null, newest: null };
    const [from, to] = this.span.range(newest ?? 0);
    // What was before the first sample would only take room.
    const first = Math.min(oldest ?? from, to - SHORTEST_S);
    return [this.span.stands ? from : Math.max(from, first), to];
  }

  private redraw(): void {
    if (this.recording) this.plot?.setData(this.recording.data(), true);
  }

  private setPaused(paused: boolean): void {
    if (paused) this.span.hold(this.recording?.newest ?? 0);
    else this.span.follow();
    this.changed();
  }

  private follow(): null {
    this.setPaused(false);
    return null;
  }

  private changed(): void {
    this.pause.textContent = t(this.span.stands ? "resume" : "pause");
    this.pause.setAttribute("aria-pressed", String(this.span.stands));
    this.redraw();
  }

  private zoom(factor: number): void {
    const [from, to] = this.range();
    this.span.zoom(factor, (from + to) / 2);
    this.changed();
  }

  private shift(share: number): void {
    const { oldest, newest } = this.recording ?? { oldest: null, newest: null };
    if (oldest === null || newest === null) return;
    this.span.shift(share * this.span.lengthS, oldest, newest);
    this.changed();
  }

  /** A mouse has marked a stretch. */
  private marked(plot: uPlot): void {
    const { left, width } = plot.select;
    if (width < 4) return;
    this.span.show(plot.posToVal(left, "x"), plot.posToVal(left + width, "x"));
    plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    this.changed();
  }

  /** One finger shifts, two zoom. */
  private touches(): void {
    const moved = (event: PointerEvent) => {
      const before = this.fingers.get(event.pointerId);
      const plot = this.plot;
      if (before === undefined || !plot) return;
      const apart = this.apart();
      this.fingers.set(event.pointerId, event.clientX);
      const width = plot.over.clientWidth || 1;
      if (this.fingers.size === 1) this.shift((before - event.clientX) / width);
      else if (apart && this.apart()) this.zoom(apart / this.apart());
    };
    const gone = (event: PointerEvent) => this.fingers.delete(event.pointerId);
    this.place.addEventListener("pointerdown", (event) => {
      if (event.pointerType === "touch") this.fingers.set(event.pointerId, event.clientX);
    });
    this.place.addEventListener("pointermove", moved);
    for (const name of ["pointerup", "pointercancel"] as const) {
      this.place.addEventListener(name, gone);
    }
  }

  private apart(): number {
    const [one, two] = [...this.fingers.values()];
    return one === undefined || two === undefined ? 0 : Math.max(8, Math.abs(one - two));
  }

  private size(): { width: number; height: number } {
    const width = Math.max(200, this.place.clientWidth);
    return { width, height: Math.max(180, Math.min(420, width * 0.55)) };
  }

  private fit(): void {
    if (this.element.offsetParent !== null) this.plot?.setSize(this.size());
  }

  private saveCsv(): void {
    if (!this.recording) return;
    save(new Blob([this.recording.csv()], { type: "text/csv" }), `cardan-${this.name}.csv`);
  }

  /** The plot with its title and the names of its lines, as a file. */
  private savePicture(): void {
    const { plot, recording } = this;
    if (!plot || !recording) return;
    const source = plot.ctx.canvas;
    const line = 18 * devicePixelRatio;
    const canvas = h("canvas", { width: source.width, height: source.height + 2 * line });
    const ink = canvas.getContext("2d");
    if (!ink) return;
    const card = getComputedStyle(this.element.closest(".card") ?? this.element);
    ink.fillStyle = card.backgroundColor;
    ink.fillRect(0, 0, canvas.width, canvas.height);
    ink.drawImage(source, 0, 2 * line);
    ink.font = `${0.7 * line}px system-ui, sans-serif`;
    ink.fillStyle = card.color;
    ink.fillText(this.title, line / 2, 0.8 * line);
    let x = line / 2;
    recording.names.forEach((name, index) => {
      ink.fillStyle = COLORS[index % COLORS.length] ?? card.color;
      ink.fillText(name, x, 1.8 * line);
      x += ink.measureText(name).width + line;
    });
    canvas.toBlob((blob) => {
      if (blob) save(blob, `cardan-${this.name}.png`);
    });
  }
}

/** Have the browser keep a file. */
export function save(blob: Blob, name: string): void {
  const href = URL.createObjectURL(blob);
  h("a", { href, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(href), 1000);
}
