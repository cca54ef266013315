import type { Arm } from "./arm.ts";
import { type Asks, FRAME_MS, Holding, endWithPage, letGoOfAll } from "./hold.ts";
import { Lease, RENEW_MS } from "./lease.ts";
import type { Link } from "./link.ts";
import type { Speeds } from "./approach.ts";
import { Pulse } from "./pulse.ts";

/** The channel of the jog frames. */
const CHANNEL = 1;

/** Of a joint's own speed, at full speed: the default of the parameter jointSpeedShare. */
const JOINT_SHARE = 0.25;

/** Moves the chosen arm while a control is held. */
export class Motion {
  readonly holding = new Holding();
  /** Why the server or the arm took the newest hold away; empty: it did not. */
  refused = "";
  /** The source that stopped the arm last; empty: none has, or this page did. */
  stoppedBy = "";
  /** Speed override, 0 to 1. */
  override = 0.2;
  /** Full speed of a jog, the arm's own limit of streams; m/s and rad/s. */
  readonly full: Speeds = { linear: 0.25, angular: 1.0 };
  onChange: () => void = () => {};
  readonly lease = new Lease();
  private renewedMs = -Infinity;
  private renewing = false;
  private arm: Arm | null = null;
  private readonly link: Link;
  private opening = false;
  private wakeLock: WakeLockSentinel | null = null;
  private readonly pulse = new Pulse();

  constructor(link: Link) {
    this.link = link;
    this.holding.onChange = () => {
      if (!this.holding.held) letGoOfAll();
      this.keepAwake(this.holding.armed);
      // What has begun or ended is said at once, not with the next frame.
      this.tick();
      this.onChange();
    };
    link.onLost = () => this.holding.end("closed");
    link.onInput = (channel, input) => {
      if (channel !== CHANNEL || input.grip !== "lost" || !input.why) return;
      if (!this.holding.held) return;
      this.refused = input.why;
      this.holding.end("refused");
    };
    this.pulse.onProof = () => this.renew();
    endWithPage((why) => this.holding.end(why));
    setInterval(() => this.tick(), FRAME_MS);
  }

  get speeds(): Speeds {
    return { linear: this.full.linear * this.override, angular: this.full.angular * this.override };
  }

  jointSpeed(velocity: number): number {
    return velocity * JOINT_SHARE * this.override;
  }

  /** Somebody has stopped the arm: every page has to be re-armed. */
  stopped(by: string): void {
    this.stoppedBy = by;
    // What the arm refused since was refused because of the stop.
    this.refused = "";
    this.holding.end("stopped");
  }

  /** Another arm is chosen: nothing is armed for it. */
  choose(arm: Arm | null): void {
    this.disarm();
    this.lease.settle();
    this.arm = arm;
    if (!arm) return;
    arm.onRequest = (request) => this.lease.heard(request, this.own, performance.now());
  }

  /** This page's name in the authority over arms; empty: not known yet. */
  get own(): string {
    return this.link.hello?.source ?? "";
  }

  /** Re-arm, before anything can be held: take the authority over the arm, and open the
   * channel to it. Resolves to why not; empty: it is armed. */
  async enable(): Promise<string> {
    if (!this.arm || this.opening || !this.own) return "";
    this.opening = true;
    this.refused = "";
    const { arm } = this;
    const why = (await this.acquire(arm)) || (await this.link.open(CHANNEL, { arm: arm.name }));
    this.opening = false;
    if (arm !== this.arm) return "";
    if (why) this.refused = why;
    else {
      this.lease.settle();
      this.holding.arm(performance.now());
    }
    this.onChange();
    return why;
  }

  /** Disarm, and give the authority up. */
  disarm(): void {
    if (this.holding.armed) {
      this.holding.disarm();
      this.tick();
    }
    this.link.close(CHANNEL);
  }

  /** Give the authority up. */
  async release(): Promise<void> {
    this.disarm();
    this.lease.settle();
    await this.arm?.ask("release").catch(() => {});
  }

  /** Ask who has the authority for it. */
  askFor(owner: string): void {
    if (this.arm && this.link.askFor(this.arm.name, owner)) this.lease.ask(performance.now());
  }

  /** Answer who asks: hand the authority over, after a stop, or keep it. Resolves to why not. */
  async answer(hands: boolean): Promise<string> {
    const { arm, lease } = this;
    const { requester } = lease;
    if (!arm || !requester) return "";
    lease.answered();
    if (!hands) {
      this.link.keepFrom(arm.name, requester);
      return "";
    }
    this.holding.end("released");
    try {
      await arm.ask("hand_over", requester);
    } catch (error) {
      return (error as Error).message;
    }
    this.disarm();
    return "";
  }

  /** Take or renew the authority; resolves to why not. */
  private async acquire(arm: Arm): Promise<string> {
    this.renewedMs = performance.now();
    this.renewing = true;
    try {
      await arm.ask("acquire");
      return "";
    } catch (error) {
      return (error as Error).message.replace(/^acquire: /, "");
    } finally {
      this.renewing = false;
    }
  }

  /** Keep the authority while motion is enabled; what moves renews it by itself. */
  private async keep(nowMs: number): Promise<void> {
    const { arm, holding, lease } = this;
    lease.look(arm?.status?.authority ?? "", this.own, nowMs);
    // What it was refused for before counts no more.
    if (lease.asked === "given") this.refused = "";
    if (!arm || arm.lends || holding.held || this.renewing || nowMs - this.renewedMs < RENEW_MS) return;
    if (!holding.armed && !lease.isNew(nowMs)) return;
    const why = await this.acquire(arm);
    if (!why || arm !== this.arm || arm.lends || holding.held) return;
    lease.settle();
    if (!holding.armed) return;
    this.disarm();
    this.refused = why;
    this.onChange();
  }

  /** A control is pressed; false: it may not move anything. */
  press(asks: Asks): boolean {
    if (this.link.slow) return false;
    this.refused = "";
    this.pulse.begin(performance.now());
    return this.holding.press(asks, performance.now());
  }

  /** Who holds is there: the server ends a hold after 10 s (its option) without. */
  renew(): void {
    if (this.holding.held) this.link.renew(CHANNEL);
  }

  private tick(): void {
    const nowMs = performance.now();
    // After this thread's own pause, which tick() notices, the echoes still wait.
    let due = this.holding.tick(nowMs);
    if (this.holding.held && !this.pulse.beat(nowMs)) {
      this.holding.end("hung");
      due = this.holding.tick(nowMs);
    }
    if (this.link.blind && this.holding.armed) {
      this.holding.end("slow");
      due = this.holding.tick(nowMs);
    }
    void this.keep(nowMs);
    if (due) this.link.send(CHANNEL, due.body, due.hold);
  }

  private keepAwake(awake: boolean): void {
    if (!awake) {
      void this.wakeLock?.release();
      this.wakeLock = null;
    } else if (!this.wakeLock && "wakeLock" in navigator) {
      navigator.wakeLock.request("screen").then(
        (lock) => {
          if (this.holding.armed) this.wakeLock = lock;
          else void lock.release();
        },
        () => {},
      );
    }
  }
}
