import { h } from "./dom.ts";

/** How many are between neighboring bounds, and beyond the last, of counts that are "no more than
 * each bound" among `total`. */
export function between(within: readonly number[], total: number): number[] {
  const counts = within.map((each, index) => each - (within[index - 1] ?? 0));
  return [...counts, Math.max(0, total - (within.at(-1) ?? 0))];
}

/** The same of numbers that are there one by one. */
export function spread(values: readonly number[], bounds: readonly number[]): number[] {
  const within = bounds.map((bound) => values.filter((each) => each <= bound).length);
  return between(within, values.length);
}

/** Bars of counts, one for each bound and one for what is beyond. */
export class Histogram {
  readonly element = h("div", { class: "bars", role: "img" });
  private readonly labels: string[];

  constructor(bounds: readonly number[], unit: string) {
    this.labels = [...bounds.map((each) => `≤${each}`), `>${bounds.at(-1)}`].map(
      (each) => `${each} ${unit}`,
    );
    this.element.append(
      ...this.labels.map((label) =>
        h("div", { class: "bar" }, h("b"), h("i"), h("span", {}, label)),
      ),
    );
    this.draw([]);
  }

  draw(counts: readonly number[]): void {
    const most = Math.max(1, ...counts);
    this.labels.forEach((_, index) => {
      const count = counts[index] ?? 0;
      const bar = this.element.children[index] as HTMLElement;
      // Logarithmic: one late answer of a million has to be seen.
      const height = count ? 0.06 + (0.94 * Math.log1p(count)) / Math.log1p(most) : 0;
      bar.style.setProperty("--height", height.toFixed(3));
      const label = bar.firstElementChild;
      const text = count ? shortened(count) : "";
      if (label && label.textContent !== text) label.textContent = text;
    });
    this.element.setAttribute(
      "aria-label",
      this.labels.map((label, index) => `${label}: ${counts[index] ?? 0}`).join(", "),
    );
  }
}

/** A count that a narrow bar has room for. */
export function shortened(count: number): string {
  if (count < 10_000) return String(count);
  return count < 1e6 ? `${Math.round(count / 1e3)}k` : `${(count / 1e6).toFixed(1)}M`;
}
