/** Samples of some numbers over the last five minutes; the oldest go. */
export const HISTORY_S = 300;

/** So much more is kept before the oldest are taken away, in one piece instead of one by one. */
const SLACK_S = 10;

export class Recording {
  readonly names: string[];
  private readonly times: number[] = [];
  private readonly columns: (number | null)[][];

  constructor(names: readonly string[]) {
    this.names = [...names];
    this.columns = names.map(() => []);
  }

  /** A sample. One of the same time as the newest is left out; one from before it begins anew, as a
   * record does that is taken back. */
  add(timeS: number, values: readonly (number | null | undefined)[]): void {
    const newest = this.newest;
    if (newest !== null && timeS <= newest) {
      if (timeS === newest) return;
      this.clear();
    }
    this.times.push(timeS);
    this.columns.forEach((column, index) => column.push(values[index] ?? null));
    if ((this.times[0] ?? 0) < timeS - HISTORY_S - SLACK_S) this.drop(timeS - HISTORY_S);
  }

  clear(): void {
    this.times.length = 0;
    for (const column of this.columns) column.length = 0;
  }

  get newest(): number | null {
    return this.times.at(-1) ?? null;
  }

  get oldest(): number | null {
    return this.times[0] ?? null;
  }

  /** Times and columns as they are now, as plots take them. */
  data(): [number[], ...(number | null)[][]] {
    return [[...this.times], ...this.columns.map((column) => [...column])];
  }

  /** As text with a row for each sample. */
  csv(): string {
    const head = ["time_s", ...this.names.map((name) => `"${name.replaceAll('"', '""')}"`)];
    const rows = this.times.map((time, row) =>
      [time.toFixed(3), ...this.columns.map((column) => column[row] ?? "")].join(","),
    );
    return [head.join(","), ...rows].join("\n") + "\n";
  }

  private drop(beforeS: number): void {
    const old = this.times.findIndex((time) => time >= beforeS);
    this.times.splice(0, old);
    for (const column of this.columns) column.splice(0, old);
  }
}
