/** The stretch of time that a plot shows: one that follows the newest sample, or one that stands. */
export class Span {
  /** How long it is, s. */
  lengthS: number;
  /** Where it ends; null: at the newest. */
  private endS: number | null = null;
  private readonly usualS: number;
  private readonly shortestS: number;
  private readonly longestS: number;

  constructor(usualS: number, shortestS: number, longestS: number) {
    [this.usualS, this.shortestS, this.longestS] = [usualS, shortestS, longestS];
    this.lengthS = usualS;
  }

  get stands(): boolean {
    return this.endS !== null;
  }

  /** From and to, s. */
  range(newestS: number): [number, number] {
    const end = this.endS ?? newestS;
    return [end - this.lengthS, end];
  }

  /** Stand where it is. */
  hold(newestS: number): void {
    this.endS ??= newestS;
  }

  /** Follow the newest again, at its usual length. */
  follow(): void {
    this.endS = null;
    this.lengthS = this.usualS;
  }

  /** Show just this. */
  show(fromS: number, toS: number): void {
    this.lengthS = this.within(toS - fromS);
    this.endS = (fromS + toS + this.lengthS) / 2;
  }

  /** Longer (above 1) or shorter; what is at `aboutS` stays where it is. Without one the end does. */
  zoom(factor: number, aboutS?: number): void {
    const length = this.within(this.lengthS * factor);
    if (this.endS !== null && aboutS !== undefined) {
      this.endS = aboutS + (this.endS - aboutS) * (length / this.lengthS);
    }
    this.lengthS = length;
  }

  /** Go to what was before (below 0) or after; it stands then. */
  shift(byS: number, oldestS: number, newestS: number): void {
    const end = (this.endS ?? newestS) + byS;
    this.endS = Math.max(Math.min(end, newestS), Math.min(oldestS + this.lengthS, newestS));
  }

  private within(lengthS: number): number {
    return Math.max(this.shortestS, Math.min(this.longestS, lengthS));
  }
}
