import assert from "node:assert/strict";
import { test } from "node:test";
import { type XrHand, startXr } from "../src/xr.ts";

class Session extends EventTarget {
  readonly space = new EventTarget();
  readonly inputSources = [];
  readonly visibilityState = "visible";
  private draw: (timeMs: number, frame: object) => void = () => {};

  async updateRenderState(): Promise<void> {}

  async requestReferenceSpace(): Promise<EventTarget> {
    return this.space;
  }

  requestAnimationFrame(draw: (timeMs: number, frame: object) => void): void {
    this.draw = draw;
  }

  /** One frame of it. */
  show(): void {
    this.draw(0, { getViewerPose: () => undefined });
  }
}

function browserWith(session: Session): void {
  const set = (owner: object, name: string, value: unknown) =>
    Object.defineProperty(owner, name, { value, configurable: true });
  set(globalThis, "document", { createElement: () => ({ getContext: () => ({}) }) });
  set(globalThis, "XRWebGLLayer", class {});
  set(globalThis, "navigator", { xr: { requestSession: async () => session } });
}

async function started(session: Session): Promise<() => number> {
  browserWith(session);
  let newest: XrHand | undefined;
  const no = () => false;
  const hear = (hands: XrHand[]) => {
    newest = hands[0];
  };
  await startXr("immersive-vr", {} as HTMLElement, no, no, hear, () => {});
  return () => {
    session.show();
    assert.ok(newest?.body.kind === "xr");
    return newest.body.reference;
  };
}

test("a reset of the reference, and a new session, are told in every frame from then on", async () => {
  const first = new Session();
  const reference = await started(first);
  const began = reference();
  assert.equal(reference(), began);
  first.space.dispatchEvent(new Event("reset"));
  assert.equal(reference(), began + 1);
  assert.equal(reference(), began + 1);
  const anew = await started(new Session());
  assert.equal(anew(), began + 2);
});
