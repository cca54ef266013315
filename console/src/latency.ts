/** Round trips of the last hundred pings, ms. */
const CAPACITY = 100;
const RECENT = 5;

export class RoundTrips {
  readonly all: number[] = [];

  add(ms: number): void {
    this.all.push(ms);
    if (this.all.length > CAPACITY) this.all.shift();
  }

  clear(): void {
    this.all.length = 0;
  }

  get newest(): number | null {
    return this.all.at(-1) ?? null;
  }

  get median(): number | null {
    return middle(this.all);
  }

  /** The middle one of the last few: one late answer is none of a slow link. */
  get recent(): number | null {
    return middle(this.all.slice(-RECENT));
  }

  get worst(): number | null {
    return this.all.length ? Math.max(...this.all) : null;
  }
}

function middle(values: readonly number[]): number | null {
  const sorted = [...values].sort((a, b) => a - b);
  return sorted[Math.floor(sorted.length / 2)] ?? null;
}

/** Above it nothing can be armed; above twice it what is held ends. */
export const SLOW_MS = 300;

export type Quality = "good" | "fair" | "bad" | "none";

export function quality(medianMs: number | null, stateAgeMs: number | null): Quality {
  if (medianMs === null || stateAgeMs === null) return "none";
  if (medianMs > SLOW_MS || stateAgeMs > 1000) return "bad";
  return medianMs > 60 || stateAgeMs > 300 ? "fair" : "good";
}

/** Of a device on another computer: delay, jitter, loss, and age at the arm; empty for others. */
export function deviceWay(metrics: Record<string, number | null>): string {
  const values = ["delay_s", "jitter_s", "loss", "age_s"].map((name) => metrics[name] ?? null);
  if (values.includes(null)) return "";
  const [delay, jitter, loss, age] = values as [number, number, number, number];
  const ms = (seconds: number) => `${(1000 * seconds).toFixed(0)} ms`;
  return `${ms(delay)} · ${ms(jitter)} · ${(100 * loss).toFixed(1)} % · ${ms(age)}`;
}
