/** Of a beat from the one before. */
const BEAT_MS = 40;

/** Without an echo for so long the browser stands still, though this page does not. */
export const SILENT_MS = 150;

/** Proof that the browser lives: what goes from this page to itself passes through its main
 * process, which hands pointers and keys to the page as well. Where that one hangs, the page would
 * go on holding and never hear that the control was let go. */
export class Pulse {
  /** The browser has proved that it lives, for the server, which bounds a hold without. */
  onProof: () => void = () => {};
  /** Whether this is a browser of which it is known that an echo passes through the thread which
   * hands pointers and keys to the page: Chromium, where it tells its name (over https, and on this
   * computer). Firefox passes it through another thread of that process, Safari through another
   * process. */
  private readonly proves = "userAgentData" in navigator;
  private readonly out: BroadcastChannel;
  private readonly back: BroadcastChannel;
  private sentMs = -Infinity;
  private heardMs = -Infinity;

  constructor() {
    // A name of its own: no other page echoes.
    const name = `cardan ${Math.random()} ${performance.timeOrigin}`;
    this.out = new BroadcastChannel(name);
    this.back = new BroadcastChannel(name);
    this.back.onmessage = () => {
      this.heardMs = performance.now();
      if (this.proves) this.onProof();
    };
  }

  /** Begin anew: the browser has just handed over what a person did. */
  begin(nowMs: number): void {
    this.heardMs = nowMs;
  }

  /** Send the beat that is due; whether the browser has answered of late. */
  beat(nowMs: number): boolean {
    if (nowMs - this.sentMs >= BEAT_MS) {
      this.sentMs = nowMs;
      this.out.postMessage(0);
    }
    return nowMs - this.heardMs <= SILENT_MS;
  }
}
