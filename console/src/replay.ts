import { Arm, type Source } from "./arm.ts";
import type { Link } from "./link.ts";
import type { Message } from "./rosbridge.ts";

/** Ends of the topics by which an arm is known in a record. */
const OF_AN_ARM = ["/state/snapshot", "/state/status", "/state/pose"];

/** Shortest time between two orders of a bar that is dragged. */
const ORDER_MS = 60;

export type About = {
  duration_s: number;
  /** When it was recorded, s since the epoch. */
  began_s: number;
  /** Type and number of messages, by name. */
  topics: Record<string, [string, number]>;
  /** Why the file has no end; empty where it has one. */
  cut_off: string;
  /** What is damaged and left out; empty: nothing. */
  damage?: string;
};

type Heard = (message: Message) => void;

/** What a record's messages are heard by, as those of the bus are. Nothing can be called. */
export class RecordSource implements Source {
  readonly hello = null;
  readonly bridge = {
    subscribe: (topic: string, _type: string, heard: Heard): (() => void) => {
      const all = this.heard.get(topic) ?? new Set<Heard>();
      this.heard.set(topic, all.add(heard));
      return () => {
        all.delete(heard);
        if (all.size === 0) this.heard.delete(topic);
      };
    },
    call: (): Promise<Message> => Promise.reject(new Error("a record is shown: nothing moves by it")),
  };
  private readonly heard = new Map<string, Set<Heard>>();

  get topics(): string[] {
    return [...this.heard.keys()].flatMap((topic) =>
      topic.endsWith("/scene") ? [topic, topic.replace(/scene$/, "surroundings")] : [topic],
    );
  }

  deliver(messages: readonly [string, Message][]): void {
    for (const [topic, message] of messages) {
      // Older records have `/surroundings`.
      const now = topic.replace(/\/surroundings$/, "/scene");
      for (const heard of this.heard.get(now) ?? []) heard(message);
    }
  }
}

/** Names of the arms in a record. */
export function armsOf(about: About): string[] {
  const found = new Set<string>();
  for (const topic of Object.keys(about.topics)) {
    const end = OF_AN_ARM.find((each) => topic.endsWith(each));
    if (end) found.add(topic.slice(0, -end.length));
  }
  return [...found].sort();
}

/** A record that the server shows to this page, and where in it one is. It moves no arm. */
export class Replay {
  name = "";
  about: About | null = null;
  /** The arm of the record that is shown. */
  arm: Arm | null = null;
  atS = 0;
  playing = false;
  rate = 1;
  /** Why it is not shown any more; empty: it is, or was closed. */
  over = "";
  /** Another arm is shown, or none any more. */
  onArm: () => void = () => {};
  onChange: () => void = () => {};
  private source = new RecordSource();
  private readonly link: Link;
  private ordered: Record<string, unknown> | null = null;
  private timer: ReturnType<typeof setTimeout> | undefined;

  constructor(link: Link) {
    this.link = link;
    link.onReplay = (said) => this.said(said);
  }

  /** Whether the page shows a record instead of the bus. */
  get open(): boolean {
    return this.name !== "";
  }

  get arms(): string[] {
    return this.about ? armsOf(this.about) : [];
  }

  /** Show a record; what comes of it `onChange` tells. */
  show(name: string): void {
    this.close();
    [this.name, this.over] = [name, ""];
    if (!this.link.tell("cardan.replay", { do: "open", name })) this.end("there is no connection");
    this.onArm();
    this.onChange();
  }

  close(): void {
    if (this.open) this.link.tell("cardan.replay", { do: "close" });
    this.end("");
  }

  /** Another arm of the record. */
  choose(name: string): void {
    this.arm?.close();
    this.source = new RecordSource();
    this.arm = new Arm(this.source, name);
    this.onArm();
    this.order({ topics: this.source.topics });
  }

  seek(atS: number): void {
    this.atS = atS;
    this.order({ at_s: atS });
  }

  play(playing: boolean): void {
    this.order({ playing });
  }

  speed(rate: number): void {
    this.order({ rate });
  }

  /** Sent at once, or a little later with those that come until then. */
  private order(order: Record<string, unknown>): void {
    this.ordered = { ...this.ordered, ...order };
    if (this.timer !== undefined) return;
    const send = () => {
      this.timer = undefined;
      if (!this.ordered || !this.open) return;
      this.link.tell("cardan.replay", { do: "order", ...this.ordered });
      this.ordered = null;
      this.timer = setTimeout(send, ORDER_MS);
    };
    send();
  }

  private said(said: Message): void {
    if (!this.open) return;
    if (said["over"] !== undefined) {
      this.end(String(said["over"]));
      return;
    }
    if (said["about"]) {
      this.about = said["about"] as About;
      const [first] = this.arms;
      if (first === undefined) {
        this.link.tell("cardan.replay", { do: "close" });
        this.end("the record has no arm that this page knows");
        return;
      }
      this.choose(first);
      this.play(true);
    } else if (said["at_s"] !== undefined) {
      // While the bar is dragged the page knows better.
      if (this.ordered?.["at_s"] === undefined) this.atS = Number(said["at_s"]);
      this.playing = Boolean(said["playing"]);
      this.rate = Number(said["rate"]);
      this.source.deliver(said["messages"] as [string, Message][]);
    }
    this.onChange();
  }

  private end(why: string): void {
    const was = this.open;
    this.arm?.close();
    [this.name, this.about, this.arm, this.ordered] = ["", null, null, null];
    [this.atS, this.playing, this.rate, this.over] = [0, false, 1, why];
    if (was) this.onArm();
    this.onChange();
  }
}
