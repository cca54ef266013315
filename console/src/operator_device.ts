import type { Body } from "./frames.ts";
import { FRAME_MS, Holding, endWithPage } from "./hold.ts";
import type { Link, Target } from "./link.ts";
import { Pulse } from "./pulse.ts";

/** A device whose raw frames go to the driver of a session, which judges them by itself. */
export class OperatorDevice {
  readonly holding = new Holding();
  tracking = true;
  /** What the server said of it last. */
  note = "";
  private readonly channel: number;
  private readonly link: Link;
  private readonly body: () => Body | null;
  private timer: ReturnType<typeof setInterval> | undefined;
  private opening = false;
  private readonly pulse = new Pulse();

  /** `body`: its state now; null: there is none, and nothing is sent. */
  constructor(channel: number, link: Link, body: () => Body | null) {
    [this.channel, this.link, this.body] = [channel, link, body];
    endWithPage((why) => this.holding.end(why));
  }

  get open(): boolean {
    return this.timer !== undefined;
  }

  /** Open its channel; resolves to why not. */
  async start(target: Target): Promise<string> {
    if (this.opening || this.open) return this.note;
    this.opening = true;
    this.note = await this.link.open(this.channel, target);
    this.opening = false;
    if (this.note) return this.note;
    this.holding.arm(performance.now());
    this.timer = setInterval(() => this.send(), FRAME_MS);
    return "";
  }

  stop(): void {
    if (!this.open) return;
    clearInterval(this.timer);
    this.timer = undefined;
    this.holding.disarm();
    this.send();
    this.link.close(this.channel);
  }

  /** The dead-man control was pressed anew: what ended the hold before is over by that. */
  press(): boolean {
    if (!this.open || this.link.slow) return false;
    const nowMs = performance.now();
    if (!this.holding.armed) this.holding.arm(nowMs);
    this.pulse.begin(nowMs);
    return this.holding.press(() => this.body(), nowMs);
  }

  /** The dead-man control, of a device that says so itself. */
  setHeld(held: boolean): void {
    if (!held) this.holding.end("released");
    else if (!this.holding.held && !this.lost) this.press();
    this.lost = held && (this.lost || !this.holding.held);
  }

  /** It has to let go before it counts again. */
  private lost = false;

  private send(): void {
    if (this.link.blind) this.holding.end("slow");
    const nowMs = performance.now();
    let due = this.holding.tick(nowMs);
    if (this.holding.held && !this.pulse.beat(nowMs)) {
      this.holding.end("hung");
      due = this.holding.tick(nowMs);
    }
    const body = this.body();
    if (body) this.link.send(this.channel, body, due?.hold ?? false, this.tracking);
    if (this.link.state !== "live") this.stop();
  }
}
