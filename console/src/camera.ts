import { type Announced, PictureAges } from "./picture_age.ts";

/** Shows a camera of the server: pictures by a socket of their own, so that none of them keeps
 * waiting what moves an arm. The server sends the next one when it hears that one was shown. */
export class CameraView {
  /** What became of it, in the server's words. */
  onSay: (why: string) => void = () => {};
  private readonly address: string;
  private readonly image: HTMLImageElement;
  private socket: WebSocket | null = null;
  private shown = "";
  private hadMs = 0;

  constructor(address: string, image: HTMLImageElement) {
    [this.address, this.image] = [address, image];
  }

  get open(): boolean {
    return this.socket !== null;
  }

  /** Of the picture that is shown, or since one was asked for. */
  get ageMs(): number {
    return performance.now() - this.hadMs;
  }

  /** Show the camera of this number. */
  start(camera: number): void {
    this.stop();
    const socket = new WebSocket(this.address);
    const ages = new PictureAges();
    let announced: (Announced & { atMs: number; hadMs: number }) | null = null;
    const say = (fields: object) => {
      if (socket.readyState !== WebSocket.OPEN) return;
      const page_us = Math.round(1000 * performance.now());
      socket.send(JSON.stringify({ op: "cardan.camera", page_us, ...fields }));
    };
    socket.binaryType = "blob";
    this.socket = socket;
    this.hadMs = performance.now();
    socket.onopen = () => say({ do: "open", camera });
    socket.onmessage = ({ data }: MessageEvent<Blob | string>) => {
      if (this.socket !== socket) return;
      const nowMs = performance.now();
      if (typeof data === "string") {
        const said = JSON.parse(data) as { op: string; why?: string; picture?: number };
        if (said.op === "cardan.camera" && said.picture !== undefined) {
          const next = said as unknown as Announced;
          announced = { ...next, atMs: nowMs, hadMs: ages.hadMs(next, nowMs) };
        } else this.said(said);
      } else if (announced) {
        const { picture, atMs, hadMs } = announced;
        const two = ages.two(nowMs - atMs);
        this.draw(data, hadMs, () => say({ do: "shown", picture, two }));
      }
    };
    socket.onclose = () => {
      if (this.socket !== socket) return;
      this.stop();
      this.onSay("the connection was lost");
    };
  }

  stop(): void {
    const socket = this.socket;
    this.socket = null;
    socket?.close();
    this.image.onload = this.image.onerror = null;
    if (this.image.src) URL.revokeObjectURL(this.image.src);
    this.image.removeAttribute("src");
  }

  /** Where the one before is not shown yet, this one comes in its place. */
  private draw(picture: Blob, hadMs: number, done: () => void): void {
    const before = this.image.src;
    this.image.onload = () => {
      this.hadMs = hadMs;
      if (this.shown) this.onSay("");
      this.shown = "";
      done();
    };
    this.image.onerror = done; // What is no picture makes none younger.
    this.image.src = URL.createObjectURL(new Blob([picture], { type: "image/jpeg" }));
    if (before) URL.revokeObjectURL(before);
  }

  private said({ op, why }: { op: string; why?: string }): void {
    if (why === undefined || (op !== "cardan.camera" && op !== "cardan.refused")) return;
    this.shown = why;
    this.onSay(why);
  }
}
