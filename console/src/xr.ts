import type { Body, XrPart } from "./frames.ts";
import type { Quat, Vec3 } from "./spatial.ts";

export type XrHand = { part: XrPart; body: Body; held: boolean; tracking: boolean };

/** Bits of a controller's buttons: what has none of its own for it aligns by its stick or touchpad. */
const ALIGN = 1 << 6;
const ALIGNING = (1 << 2) | (1 << 3);

const MODES = ["immersive-ar", "immersive-vr"] as const;

/** Counts the references of poses: the sessions of this page, and the resets of each. */
let references = 0;

/** The session that this browser offers here; null: none. */
export async function xrMode(): Promise<XRSessionMode | null> {
  for (const mode of MODES) {
    if (await navigator.xr?.isSessionSupported(mode).catch(() => false)) return mode;
  }
  return null;
}

/** Run a session; called in a click. `touched`, `aligning`: the overlay's buttons, for a phone.
 * `hear` gets all hands at each frame of it, `ended` its end. Returns what ends it. */
export async function startXr(
  mode: XRSessionMode,
  overlay: HTMLElement,
  touched: () => boolean,
  aligning: () => boolean,
  hear: (hands: XrHand[]) => void,
  ended: () => void,
): Promise<() => void> {
  if (!navigator.xr) throw new Error("there is no WebXR");
  const session = await navigator.xr.requestSession(mode, {
    requiredFeatures: ["local-floor"],
    optionalFeatures: ["dom-overlay"],
    domOverlay: { root: overlay },
  });
  session.addEventListener("end", ended);
  const canvas = document.createElement("canvas");
  const gl = canvas.getContext("webgl2", { xrCompatible: true });
  if (!gl) {
    await session.end();
    throw new Error("there is no WebGL");
  }
  // Without a layer a session gives no frames.
  await session.updateRenderState({ baseLayer: new XRWebGLLayer(session, gl) });
  const space = await session.requestReferenceSpace("local-floor");
  references += 1;
  // The headset was recentered, or has found itself elsewhere: all poses are others now.
  space.addEventListener("reset", () => {
    references += 1;
  });
  const draw = (_time: number, frame: XRFrame) => {
    session.requestAnimationFrame(draw);
    const visible = session.visibilityState === "visible";
    const hands = [...session.inputSources]
      .map((source) => hand(frame, source, space, visible))
      .filter((each) => each !== null);
    hear(hands.length ? hands : [viewer(frame, space, visible, touched(), aligning())]);
  };
  session.requestAnimationFrame(draw);
  return () => void session.end();
}

function hand(
  frame: XRFrame,
  source: XRInputSource,
  space: XRReferenceSpace,
  visible: boolean,
): XrHand | null {
  if (!source.gripSpace || source.handedness === "none") return null;
  const part: XrPart = source.handedness;
  const pose = frame.getPose(source.gripSpace, space);
  const [trigger, squeeze] = source.gamepad?.buttons ?? [];
  const axes = source.gamepad?.axes ?? [];
  let buttons = 0;
  (source.gamepad?.buttons ?? []).forEach((button, bit) => {
    if (button?.pressed && bit < 6) buttons |= 1 << bit;
  });
  if (buttons & ALIGNING) buttons |= ALIGN;
  return {
    part,
    held: squeeze?.pressed ?? false,
    tracking: tracked(pose) && visible,
    body: xrBody(part, pose, {
      buttons,
      stickRight: axes[2] ?? 0,
      stickDown: axes[3] ?? 0,
      trigger: trigger?.value ?? 0,
      squeeze: squeeze?.value ?? 0,
    }),
  };
}

function viewer(
  frame: XRFrame,
  space: XRReferenceSpace,
  visible: boolean,
  held: boolean,
  aligning: boolean,
): XrHand {
  const pose = frame.getViewerPose(space);
  const buttons = aligning ? ALIGN : 0;
  const controls = { buttons, stickRight: 0, stickDown: 0, trigger: 0, squeeze: 0 };
  return {
    part: "viewer",
    held,
    tracking: tracked(pose) && visible,
    body: xrBody("viewer", pose, controls),
  };
}

/** An emulated position is a guess: the tracking is lost. */
function tracked(pose: XRPose | undefined): boolean {
  return pose !== undefined && !pose.emulatedPosition;
}

type Controls = {
  buttons: number;
  stickRight: number;
  stickDown: number;
  trigger: number;
  squeeze: number;
};

function xrBody(part: XrPart, pose: XRPose | undefined, controls: Controls): Body {
  const { position, orientation } = pose?.transform ?? {
    position: { x: 0, y: 0, z: 0 },
    orientation: { x: 0, y: 0, z: 0, w: 1 },
  };
  const positionM: Vec3 = [position.x, position.y, position.z];
  const turn: Quat = [orientation.x, orientation.y, orientation.z, orientation.w];
  return { kind: "xr", part, positionM, orientation: turn, ...controls, reference: references };
}
