/** Shows a camera of the server: pictures by a socket of their own, so that none of them keeps
 * waiting what moves an arm. */
export class CameraView {
  /** What became of it, in the server's words. */
  onSay: (why: string) => void = () => {};
  private readonly address: string;
  private readonly image: HTMLImageElement;
  private socket: WebSocket | null = null;
  private shown = "";

  constructor(address: string, image: HTMLImageElement) {
    [this.address, this.image] = [address, image];
  }

  get open(): boolean {
    return this.socket !== null;
  }

  /** Show the camera of this number. */
  start(camera: number): void {
    this.stop();
    const socket = new WebSocket(this.address);
    socket.binaryType = "blob";
    this.socket = socket;
    socket.onopen = () => socket.send(JSON.stringify({ op: "cardan.camera", do: "open", camera }));
    socket.onmessage = ({ data }: MessageEvent<Blob | string>) => {
      if (this.socket !== socket) return;
      if (typeof data !== "string") this.draw(data);
      else this.said(JSON.parse(data) as { op: string; why?: string });
    };
    socket.onclose = () => {
      if (this.socket !== socket) return;
      this.socket = null;
      this.onSay("the connection was lost");
    };
  }

  stop(): void {
    const socket = this.socket;
    this.socket = null;
    socket?.close();
    if (this.image.src) URL.revokeObjectURL(this.image.src);
    this.image.removeAttribute("src");
  }

  private draw(picture: Blob): void {
    if (!this.image.complete) return; // It is slower than the camera.
    const before = this.image.src;
    this.image.src = URL.createObjectURL(new Blob([picture], { type: "image/jpeg" }));
    if (before) URL.revokeObjectURL(before);
    if (this.shown) this.onSay("");
    this.shown = "";
  }

  private said({ op, why }: { op: string; why?: string }): void {
    if (why === undefined || (op !== "cardan.camera" && op !== "cardan.refused")) return;
    this.shown = why;
    this.onSay(why);
  }
}
