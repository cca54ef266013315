/** Sound of this device: plays a file, records its microphone, says a text. Nothing of it leaves the
 * page. */
export class Sound {
  private context: AudioContext | null = null;
  private playing: AudioBufferSourceNode | null = null;
  private recorder: MediaRecorder | null = null;
  /** What was recorded last. */
  recorded: Blob | null = null;
  onChange: () => void = () => {};

  get plays(): boolean {
    return this.playing !== null;
  }

  get records(): boolean {
    return this.recorder !== null;
  }

  /** Whether the browser lets a page record: only by https or on its own computer. */
  static get canRecord(): boolean {
    return "MediaRecorder" in window && Boolean(navigator.mediaDevices?.getUserMedia);
  }

  static get canSpeak(): boolean {
    return "speechSynthesis" in window && "SpeechSynthesisUtterance" in window;
  }

  /** Play a file. Rejects with why the browser cannot. */
  async play(sound: Blob): Promise<void> {
    this.silence();
    this.context ??= new AudioContext();
    await this.context.resume();
    const buffer = await this.context.decodeAudioData(await sound.arrayBuffer());
    const source = this.context.createBufferSource();
    source.buffer = buffer;
    source.connect(this.context.destination);
    source.onended = () => {
      if (this.playing === source) this.playing = null;
      this.onChange();
    };
    this.playing = source;
    source.start();
    this.onChange();
  }

  silence(): void {
    this.playing?.stop();
    this.playing = null;
    this.onChange();
  }

  /** Record the microphone, which the browser asks about. Rejects with why it cannot. */
  async record(): Promise<void> {
    const stream = await navigator.mediaDevices.getUserMedia({ audio: true });
    const recorder = new MediaRecorder(stream);
    const pieces: Blob[] = [];
    recorder.ondataavailable = ({ data }) => pieces.push(data);
    recorder.onstop = () => {
      for (const track of stream.getTracks()) track.stop();
      this.recorded = new Blob(pieces, { type: recorder.mimeType });
      this.recorder = null;
      this.onChange();
    };
    this.recorder = recorder;
    recorder.start();
    this.onChange();
  }

  finish(): void {
    this.recorder?.stop();
  }
}

/** Say a text in the page's language, in place of what is being said. */
export function say(text: string, language: string): void {
  speechSynthesis.cancel();
  const words = new SpeechSynthesisUtterance(text);
  words.lang = language;
  speechSynthesis.speak(words);
}
