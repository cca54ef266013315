import { type Body, encodeFrame } from "./frames.ts";
import { RoundTrips, SLOW_MS } from "./latency.ts";
import { LONGEST_PERSON } from "./settings.ts";
import { type LinkState, type Message, Rosbridge } from "./rosbridge.ts";

const PING_MS = 250;

/** How often at most the server is told that who holds is still there. */
const RENEW_MS = 500;

/** A ping that has no answer after so long counts as that slow. */
const LOST_PING_MS = 2000;

/** What a channel's frames are for: an arm's node, the topic of a driver, or that of a sensor. */
export type Target = { arm: string } | { device: string } | { joy: string } | { imu: string };

/** What the server says of a channel's frames. */
export type Input = {
  grip: "free" | "held" | "lost";
  why: string;
  rate_hz: number;
  age_ms: number | null;
  dropped: Record<string, number>;
  /** What holds ends after so long unless it is renewed, s; none: nothing is held. */
  left_s?: number;
};

export type Order = "list" | "start" | "stop" | "restart" | "doctor";

type Asked = { resolve: (answer: Message) => void; reject: (why: Error) => void };

export type Hello = { version: string; role: string; source: string; fresh_ms: number };

/** The page's socket: its clock, its round trips, and the operator frames of its channels. */
export class Link {
  readonly bridge: Rosbridge;
  readonly roundTrips = new RoundTrips();
  state: LinkState = "connecting";
  hello: Hello | null = null;
  readonly inputs = new Map<number, Input>();
  private readonly renewedMs = new Map<number, number>();
  /** Frames that were not sent, as those before still waited. */
  dropped = 0;
  /** Why the server refused the last operation. */
  refusal = "";
  onLost: () => void = () => {};
  onInput: (channel: number, input: Input) => void = () => {};
  onFeedback: (channel: number, intensity: number) => void = () => {};
  private readonly opened = new Map<number, (why: string) => void>();
  /** A record that is shown to this page. */
  onReplay: (said: Message) => void = () => {};
  private readonly asked = new Map<string, Asked>();
  private lastAsked = 0;
  /** Of the person, part of the page's name in the authority over arms; empty: not told. */
  private person = "";
  private sequence = 0;
  private waited = false;
  private pinged: { id: string; atMs: number } | null = null;
  private pings = 0;

  constructor(bridge: Rosbridge) {
    this.bridge = bridge;
    bridge.onOperation = (operation) => this.receive(operation);
    bridge.onState = (state) => this.changed(state);
    bridge.connect();
    setInterval(() => this.ping(), PING_MS);
  }

  /** Too slow for beginning to move anything. */
  get slow(): boolean {
    return this.answersWithin > SLOW_MS;
  }

  /** So slow that what is held has to end: nobody sees what it does. */
  get blind(): boolean {
    return this.answersWithin > 2 * SLOW_MS;
  }

  /** How long answers take, ms; one that is late counts before it comes. */
  private get answersWithin(): number {
    const waitsMs = this.pinged ? performance.now() - this.pinged.atMs : 0;
    return Math.max(waitsMs, this.roundTrips.recent ?? 0);
  }

  /** Open a channel; resolves to why not, empty where it is open. */
  open(channel: number, target: Target): Promise<string> {
    this.inputs.delete(channel);
    return new Promise((resolve) => {
      if (!this.bridge.send({ op: "cardan.open", id: `open:${channel}`, channel, ...target })) {
        resolve("there is no connection");
        return;
      }
      this.opened.set(channel, resolve);
    });
  }

  /** Have the server's daemon do something; resolves to what its command prints. */
  async order(order: Order, name?: string): Promise<unknown> {
    return (await this.ask("cardan.daemon", { do: order, name }))["result"];
  }

  /** Ask the server for an operation of its own; rejects with why it is refused. */
  ask(op: string, fields: Message): Promise<Message> {
    const id = `ask:${++this.lastAsked}`;
    return new Promise((resolve, reject) => {
      if (!this.bridge.send({ op, id, ...fields })) reject(new Error("there is no connection"));
      else this.asked.set(id, { resolve, reject });
    });
  }

  /** Ask `owner` for the authority over an arm. */
  askFor(arm: string, owner: string): boolean {
    return this.bridge.send({ op: "cardan.ask", arm, owner });
  }

  /** Tell `source`, which has asked, that it does not get the authority. */
  keepFrom(arm: string, source: string): boolean {
    return this.bridge.send({ op: "cardan.keep", arm, source });
  }

  /** Have it done, without an answer; false where there is no connection. */
  tell(op: string, fields: Message): boolean {
    return this.bridge.send({ op, ...fields });
  }

  /** The person who holds on this channel has just proved to be there. */
  renew(channel: number): void {
    const nowMs = performance.now();
    if (nowMs - (this.renewedMs.get(channel) ?? -Infinity) < RENEW_MS) return;
    this.renewedMs.set(channel, nowMs);
    this.bridge.send({ op: "cardan.renew", channel });
  }

  close(channel: number): void {
    this.inputs.delete(channel);
    this.bridge.send({ op: "cardan.close", channel });
  }

  /** Send the state of a device; false where it was dropped, as the link is slow or gone. What holds
   * is never queued: it is dropped where frames before still wait. */
  send(channel: number, body: Body, hold: boolean, tracking = true): boolean {
    const waits = this.bridge.waiting > 0;
    const slow = waits && this.waited;
    this.waited = waits;
    if (slow && hold) {
      this.dropped += 1;
      return false;
    }
    this.sequence += 1;
    return this.bridge.sendFrame(
      encodeFrame({
        body,
        hold,
        tracking,
        visible: document.visibilityState === "visible",
        channel,
        sequence: this.sequence,
        timeUs: pageUs(),
      }),
    );
  }

  /** Tell who is here; it counts from when no channel is open. */
  name(person: string): void {
    this.person = person.slice(0, LONGEST_PERSON);
    this.greet();
  }

  private greet(): void {
    this.bridge.send({ op: "cardan.hello", id: "hello", name: this.person });
  }

  private changed(state: LinkState): void {
    const was = this.state;
    this.state = state;
    if (state === "live") this.greet();
    if (state !== "lost" || was !== "live") return;
    for (const resolve of this.opened.values()) resolve("the connection was lost");
    this.opened.clear();
    for (const each of this.asked.values()) each.reject(new Error("the connection was lost"));
    this.asked.clear();
    this.onReplay({ over: "the connection was lost" });
    this.inputs.clear();
    this.roundTrips.clear();
    this.pinged = null;
    this.hello = null;
    this.onLost();
  }

  private ping(): void {
    const nowMs = performance.now();
    if (this.pinged) {
      if (nowMs - this.pinged.atMs < LOST_PING_MS) return;
      this.roundTrips.add(nowMs - this.pinged.atMs);
    }
    const id = `ping:${++this.pings}`;
    if (this.bridge.send({ op: "cardan.ping", id, page_us: pageUs() })) {
      this.pinged = { id, atMs: nowMs };
    }
  }

  private receive(operation: Message): void {
    const asked = this.asked.get(String(operation["id"]));
    if (asked && operation["op"] !== "cardan.refused") {
      this.asked.delete(String(operation["id"]));
      asked.resolve(operation);
      return;
    }
    const channel = Number(operation["channel"]);
    switch (operation["op"]) {
      case "cardan.ping":
        this.bridge.send({
          op: "cardan.pong",
          server_us: operation["server_us"],
          page_us: pageUs(),
        });
        break;
      case "cardan.pong":
        if (this.pinged && operation["id"] === this.pinged.id) {
          this.roundTrips.add(performance.now() - this.pinged.atMs);
          this.pinged = null;
        }
        break;
      case "cardan.hello":
        this.hello = operation as unknown as Hello;
        break;
      case "cardan.opened":
        this.opened.get(channel)?.("");
        this.opened.delete(channel);
        break;
      case "cardan.input": {
        const input = operation as unknown as Input;
        this.inputs.set(channel, input);
        this.onInput(channel, input);
        break;
      }
      case "cardan.replay":
        this.onReplay(operation);
        break;
      case "cardan.feedback":
        this.onFeedback(channel, Number(operation["intensity"]));
        break;
      case "cardan.refused":
        this.refused(operation);
    }
  }

  private refused(operation: Message): void {
    this.refusal = String(operation["why"]);
    const id = String(operation["id"] ?? "");
    this.asked.get(id)?.reject(new Error(this.refusal));
    this.asked.delete(id);
    if (operation["asked"] === "cardan.replay") this.onReplay({ over: this.refusal });
    if (!id.startsWith("open:")) return;
    const channel = Number(id.slice("open:".length));
    this.opened.get(channel)?.(this.refusal);
    this.opened.delete(channel);
  }
}

/** The page's monotonic time, µs. */
function pageUs(): number {
  return Math.floor(performance.now() * 1000);
}
