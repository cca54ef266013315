/** Shows a message with its codes, "... [S004]", as the terminal does. The server knows them by the
 * message's words; it is asked once for each message, and for one at a time. */
export class Codes {
  private readonly known = new Map<string, string>();
  private asking = false;

  private readonly ask: (text: string) => Promise<readonly string[]>;

  /** `ask`: the codes of a message; rejects where the server is not there. */
  constructor(ask: (text: string) => Promise<readonly string[]>) {
    this.ask = ask;
  }

  /** `text` with its codes, as soon as they are known. */
  shown(text: string): string {
    const known = this.known.get(text);
    if (known === undefined && !this.asking) void this.learn(text);
    return known ?? text;
  }

  private async learn(text: string): Promise<void> {
    this.asking = true;
    try {
      const codes = await this.ask(text);
      // A message with a number that changes is another one each time.
      if (this.known.size >= MOST_KNOWN) this.known.clear();
      this.known.set(text, codes.length ? `${text} [${codes.join(", ")}]` : text);
    } catch {
      // It is asked for again while the message is shown.
    } finally {
      this.asking = false;
    }
  }
}

/** So many messages are kept with their codes. */
const MOST_KNOWN = 100;
