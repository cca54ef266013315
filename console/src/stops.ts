/** What a new count of an arm's stops means: none, only this page's own, or somebody else's. */
export type Stopped = "no" | "own" | "other";

/** Tells this page's own stops from those of others, by the arm's count of all of them. */
export class Stops {
  private counted: number | undefined;
  /** Own ones that the arm has not counted yet. */
  private own = 0;

  /** This page asks for a stop. */
  asked(): void {
    this.own++;
  }

  /** It failed: the arm will not count it. */
  failed(): void {
    this.own = Math.max(0, this.own - 1);
  }

  /** The arm says how many it has counted. A session that was started anew counts anew: that is
   * another's stop, too. */
  heard(count: number): Stopped {
    const more = count - (this.counted ?? count);
    this.counted = count;
    if (more === 0) return "no";
    const own = more > 0 && more <= this.own;
    this.own = own ? this.own - more : 0;
    return own ? "own" : "other";
  }
}
