/** Pictures this old are marked as old, and these are none of now, ms. */
export const OLD_MS = 500;
export const GONE_MS = 2000;

/** Round trips of the last pictures. */
const CAPACITY = 32;

/** A way so long that one picture at a time leaves most of it empty, ms. */
const LONG_MS = 100;

/** What the server says of a picture ahead of it; times in µs, `page_us` of this page's clock. */
export interface Announced {
  picture: number;
  /** Since the server had it, when it was sent. */
  age_us: number;
  /** When this page sent the last that the server has heard, and how long ago it heard that. */
  page_us: number;
  held_us: number;
}

export type Freshness = "fresh" | "old" | "gone";

export const freshness = (ageMs: number): Freshness =>
  ageMs < OLD_MS ? "fresh" : ageMs < GONE_MS ? "old" : "gone";

/** How old pictures are, by round trips of their own socket: half of the quickest is the way here,
 * and what one takes longer counts as the picture's, so that no wait makes it younger. */
export class PictureAges {
  private readonly rounds: number[] = [];

  /** When the server had a picture, ms of this page's clock; `nowMs`: when its announcement came. */
  hadMs({ age_us, page_us, held_us }: Announced, nowMs: number): number {
    const round = Math.max(0, nowMs - (page_us + held_us) / 1000);
    this.rounds.push(round);
    if (this.rounds.length > CAPACITY) this.rounds.shift();
    return nowMs - age_us / 1000 - round + this.least / 2;
  }

  /** Whether a second picture may be on its way: where the way is long, and a picture, which came
   * `transferMs` after its announcement, takes less of the link's time than it. */
  two(transferMs: number): boolean {
    return this.least >= LONG_MS && transferMs < this.least / 2;
  }

  private get least(): number {
    return Math.min(...this.rounds);
  }
}
