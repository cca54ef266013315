/** "refused": the server does not know the token, and is not asked again. */
export type LinkState = "connecting" | "live" | "lost" | "refused";

/** What the server publishes: messages of a topic as JSON has them. */
export type Message = Record<string, unknown>;

type Heard = (message: Message) => void;
type Topic = { type: string; everyMs: number; heard: Set<Heard> };
type Answered = { resolve: (values: Message) => void; reject: (reason: Error) => void };

const RECONNECT_MS = 1000;

/** Of HTTP: no token, or a wrong one; too many wrong ones. */
const UNAUTHORIZED = 401;
const TOO_MANY = 429;

/** A client of rosbridge v2 in JSON, which connects again by itself and subscribes again. Calls that
 * had no answer when the link was lost are refused; nothing is sent later than it was asked for. */
export class Rosbridge {
  /** The server's own operations, which begin with "cardan.". */
  onOperation: (operation: Message) => void = () => {};
  onState: (state: LinkState) => void = () => {};
  private socket: WebSocket | undefined;
  private readonly topics = new Map<string, Topic>();
  private readonly calls = new Map<string, Answered>();
  private lastId = 0;

  private readonly address: string;

  constructor(address: string) {
    this.address = address;
  }

  get live(): boolean {
    return this.socket?.readyState === WebSocket.OPEN;
  }

  /** Bytes that wait to be sent. */
  get waiting(): number {
    return this.socket?.bufferedAmount ?? 0;
  }

  /** Send an operator frame; false where there is no connection. */
  sendFrame(frame: Uint8Array<ArrayBuffer>): boolean {
    if (!this.live) return false;
    this.socket?.send(frame);
    return true;
  }

  /** Hear a topic, at most once in `everyMs`; returns what ends that. */
  subscribe(topic: string, type: string, heard: Heard, everyMs = 0): () => void {
    const known = this.topics.get(topic) ?? { type, everyMs, heard: new Set<Heard>() };
    this.topics.set(topic, known);
    known.heard.add(heard);
    if (known.heard.size === 1) this.ask(topic, known);
    return () => {
      known.heard.delete(heard);
      if (known.heard.size === 0 && this.topics.delete(topic)) this.send({ op: "unsubscribe", topic });
    };
  }

  call(service: string, args: Message): Promise<Message> {
    const id = `call:${++this.lastId}`;
    return new Promise((resolve, reject) => {
      if (!this.send({ op: "call_service", id, service, args })) {
        reject(new Error("there is no connection"));
        return;
      }
      this.calls.set(id, { resolve, reject });
    });
  }

  /** Send an operation; false where there is no connection, and nothing was sent. */
  send(operation: Message): boolean {
    if (!this.live) return false;
    this.socket?.send(JSON.stringify(operation));
    return true;
  }

  private ask(topic: string, { type, everyMs }: Topic): void {
    this.send({ op: "subscribe", topic, type, queue_length: 1, throttle_rate: everyMs });
  }

  /** Connect, and again whenever the connection is lost. */
  connect(): void {
    this.onState("connecting");
    const socket = new WebSocket(this.address);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    let opened = false;
    socket.onopen = () => {
      opened = true;
      for (const [topic, known] of this.topics) this.ask(topic, known);
      this.onState("live");
    };
    socket.onmessage = (event: MessageEvent<unknown>) => {
      if (typeof event.data === "string") this.receive(JSON.parse(event.data) as Message);
    };
    socket.onclose = () => {
      for (const each of this.calls.values()) each.reject(new Error("the connection was lost"));
      this.calls.clear();
      this.onState("lost");
      void this.again(opened);
    };
  }

  /** Connect again, if that can help: of a socket that was never open only HTTP says why. */
  private async again(opened: boolean): Promise<void> {
    let waitMs = RECONNECT_MS;
    if (!opened) {
      const answer = await fetch(this.address.replace(/^ws/, "http")).catch(() => null);
      if (answer?.status === UNAUTHORIZED) {
        this.onState("refused");
        return;
      }
      if (answer?.status === TOO_MANY) {
        waitMs = Math.max(waitMs, 1000 * Number(answer.headers.get("Retry-After")));
      }
    }
    setTimeout(() => this.connect(), waitMs);
  }

  private receive(operation: Message): void {
    if (operation["op"] === "publish") {
      const message = operation["msg"] as Message;
      for (const heard of this.topics.get(operation["topic"] as string)?.heard ?? []) heard(message);
    } else if (operation["op"] === "service_response") {
      const call = this.calls.get(operation["id"] as string);
      this.calls.delete(operation["id"] as string);
      if (operation["result"]) call?.resolve(operation["values"] as Message);
      else call?.reject(new Error(String(operation["values"])));
    } else if (String(operation["op"]).startsWith("cardan.")) {
      this.onOperation(operation);
    }
  }
}
