import type { AuthorityRequest } from "./lease.ts";
import type { Link } from "./link.ts";
import type { Message, Rosbridge } from "./rosbridge.ts";
import type { Pose, Quat, Vec3 } from "./spatial.ts";
import { Stops } from "./stops.ts";
import type { Heard, SceneDescription } from "./scene_description.ts";

const ASK_TYPE = "cardan_msgs/srv/Ask";

/** As often as the page draws: faster topics are thinned by the server. */
const DRAWN_MS = 16;

/** The session's snapshot, of which the page reads these. A session or record of another version of
 * Cardan may lack parts. */
export type Snapshot = {
  finished?: boolean;
  error?: string;
  diagnosis?: string[];
  arm?: {
    message: string;
    authority_s: number | null;
    stops: number;
    stopped_by: string;
    at_workspace_limit: boolean;
    clearance_m: number | null;
    nearest_pair: string[];
    limits_in_words: string[];
    path_speed: number | null;
  };
  robot?: { hold_reason: string };
  device?: { axes: number[]; metrics: Record<string, number | null> };
  loop?: {
    cycles: number;
    inputs: number;
    tick_p50_s: number | null;
    tick_p99_s: number | null;
    tick_within: number[];
    input_age_within: number[];
  };
};

export type Status = {
  phase: string;
  message: string;
  authority: string;
  ready: boolean;
  moving: boolean;
  lead_used: number;
  limits: string[];
};

export type Joints = { names: string[]; positions: number[]; velocities: number[] };

type XYZ = { x: number; y: number; z: number };
type XYZW = XYZ & { w: number };

const vec = ({ x, y, z }: XYZ): Vec3 => [x, y, z];
const quat = ({ x, y, z, w }: XYZW): Quat => [x, y, z, w];

/** Names of all arms that take commands: nodes that offer the verbs. */
export async function findArms(link: Link): Promise<string[]> {
  const found = await link.bridge.call("/rosapi/services_for_type", { type: ASK_TYPE });
  const services = found["services"] as string[];
  return services
    .filter((name) => name.endsWith("/ask"))
    .map((name) => name.slice(0, -"/ask".length))
    .sort();
}

/** Where an arm is heard and asked: the link to the bus, or a record. */
export type Source = {
  readonly bridge: Pick<Rosbridge, "subscribe" | "call">;
  readonly hello: { source: string } | null;
};

/** The newest of all that an arm's session publishes, and its verbs. */
export class Arm {
  readonly name: string;
  description = "";
  joints: Joints | null = null;
  measured: Pose | null = null;
  commanded: Pose | null = null;
  twist: { linear: Vec3; angular: Vec3 } | null = null;
  wrench: { force: Vec3; torque: Vec3 } | null = null;
  /** From flange to TCP, and the names of both. */
  tcp: { parent: string; pose: Pose } | null = null;
  status: Status | null = null;
  snapshot: Snapshot | null = null;
  sceneDescription: SceneDescription | null = null;
  /** Where its neighbors were heard to be, by their names. */
  readonly neighbors = new Map<string, Heard>();
  /** When the newest state came, ms of the page. */
  heardMs = -Infinity;
  onDescription: () => void = () => {};
  onState: () => void = () => {};
  onSceneDescription: () => void = () => {};
  /** The arm was stopped by another source than this page. */
  onStop: (by: string) => void = () => {};
  onRequest: (request: AuthorityRequest) => void = () => {};
  /** The authority is not ours for a moment, as its parameters are set. */
  lends = false;
  private readonly link: Source;
  private readonly ends: (() => void)[] = [];
  private readonly neighborEnds: (() => void)[] = [];
  private requests = 0;
  private readonly stops = new Stops();

  constructor(link: Source, name: string) {
    this.link = link;
    this.name = name;
    const below = name.slice(0, name.lastIndexOf("/"));
    const hear = (
      topic: string,
      type: string,
      take: (message: never) => void,
      everyMs = DRAWN_MS,
    ) => {
      this.ends.push(link.bridge.subscribe(topic, type, take as (m: Message) => void, everyMs));
    };
    hear(`${below}/joint_states`, "sensor_msgs/msg/JointState", (m: JointState) => {
      this.joints = { names: m.name, positions: m.position, velocities: m.velocity };
      this.heard();
    });
    hear(`${below}/robot_description`, "std_msgs/msg/String", (m: { data: string }) => {
      this.description = m.data;
      this.onDescription();
    }, 0);
    hear(`${name}/scene`, "std_msgs/msg/String", (m: { data: string }) => {
      this.sceneDescription = JSON.parse(m.data) as SceneDescription;
      this.hearNeighbors(this.sceneDescription);
      this.onSceneDescription();
    }, 0);
    hear("/tf_static", "tf2_msgs/msg/TFMessage", (m: Transforms) => {
      for (const each of m.transforms) {
        const { translation, rotation } = each.transform;
        const pose = { position: vec(translation), orientation: quat(rotation) };
        this.tcp = { parent: each.header.frame_id, pose };
      }
    }, 0);
    hear(`${name}/state/pose`, "geometry_msgs/msg/PoseStamped", (m: PoseStamped) => {
      this.measured = posed(m);
      this.heard();
    });
    hear(`${name}/state/target`, "geometry_msgs/msg/PoseStamped", (m: PoseStamped) => {
      this.commanded = posed(m);
    });
    hear(`${name}/state/twist`, "geometry_msgs/msg/TwistStamped", (m: TwistStamped) => {
      this.twist = { linear: vec(m.twist.linear), angular: vec(m.twist.angular) };
    });
    hear(`${name}/state/wrench`, "geometry_msgs/msg/WrenchStamped", (m: WrenchStamped) => {
      this.wrench = { force: vec(m.wrench.force), torque: vec(m.wrench.torque) };
    });
    hear(`${name}/state/status`, "cardan_msgs/msg/ArmStatus", (m: Status) => {
      this.status = m;
      this.heard();
    });
    hear(`${name}/authority/request`, "cardan_msgs/msg/AuthorityRequest", (m: AuthorityRequest) => {
      this.onRequest(m);
    }, 0);
    hear(`${name}/state/snapshot`, "std_msgs/msg/String", (m: { data: string }) => {
      this.snapshot = JSON.parse(m.data) as Snapshot;
      const told = this.snapshot.arm;
      // This page's own has disarmed it at once: it may be enabled anew before it is counted.
      if (told && this.stops.heard(told.stops) === "other") this.onStop(told.stopped_by);
      this.heard();
    }, 0);
  }

  /** Hear no more of it. */
  close(): void {
    for (const end of [...this.ends, ...this.neighborEnds]) end();
    this.ends.length = this.neighborEnds.length = 0;
  }

  private hearNeighbors(told: SceneDescription): void {
    for (const end of this.neighborEnds) end();
    this.neighborEnds.length = 0;
    this.neighbors.clear();
    for (const { name, topic, joints } of told.neighbors ?? []) {
      const take = (message: Message) => {
        const m = message as unknown as JointState;
        const positions = new Map(m.name.map((each, index) => [each, m.position[index] ?? NaN]));
        // Others may publish on the topic, too.
        if (!joints.every((each) => Number.isFinite(positions.get(each.name)))) return;
        this.neighbors.set(name, { joints: positions, ms: performance.now() });
      };
      const type = "sensor_msgs/msg/JointState";
      this.neighborEnds.push(this.link.bridge.subscribe(topic, type, take, DRAWN_MS));
    }
  }

  /** A verb of the Cartesian interface; docs/cartesian-device.md. Rejects with the arm's reason. */
  async ask(verb: string, value?: unknown): Promise<unknown> {
    const source = this.link.hello?.source ?? "console";
    const request = { id: ++this.requests, source, verb, ...(value === undefined ? {} : { value }) };
    const answer = await this.link.bridge.call(`${this.name}/ask`, {
      request: JSON.stringify(request),
    });
    const reply = JSON.parse(String(answer["reply"])) as {
      result?: unknown;
      error?: { message: string };
    };
    if (reply.error) throw new Error(reply.error.message);
    return reply.result;
  }

  /** Brake the arm, without authority over it. Rejects with why that is not known to have worked. */
  async stop(): Promise<void> {
    this.stops.asked();
    try {
      const answer = await this.link.bridge.call(`${this.name}/stop`, {});
      if (!answer["success"]) throw new Error(String(answer["message"]));
    } catch (error) {
      this.stops.failed();
      throw error;
    }
  }

  /** The joints at which the TCP has a pose, on the branch nearest to now. */
  async inverse(pose: Pose): Promise<number[]> {
    const [x, y, z, w] = pose.orientation;
    return (await this.ask("inv", [...pose.position, w, x, y, z])) as number[];
  }

  /** What would stop the straight line of the TCP to a pose, or the straight motion of the joints;
   * empty: nothing. Rejects where that is not known. */
  async rehearse(way: Pose | readonly number[]): Promise<string> {
    let found;
    if ("position" in way) {
      const [x, y, z, w] = way.orientation;
      found = await this.ask("rehearse_line", [...way.position, w, x, y, z]);
    } else {
      found = await this.ask("rehearse_joints", way);
    }
    return (found as { refusal: string }).refusal;
  }

  /** Set parameters of the arm's node; rejects where they cannot be asked for. They are set by the
   * network, another source of the arm than this page, which lends it the authority for that. */
  async setParameters(parameters: Message[]): Promise<Message> {
    const { bridge } = this.link;
    const ours = this.status?.authority === this.link.hello?.source;
    this.lends = true;
    try {
      if (ours) await this.ask("release");
      return await bridge.call(`${this.name}/set_parameters`, { parameters });
    } finally {
      await bridge.call(`${this.name}/release`, {}).catch(() => {});
      if (ours) await this.ask("acquire").catch(() => {});
      this.lends = false;
    }
  }

  private heard(): void {
    this.heardMs = performance.now();
    this.onState();
  }
}

type JointState = { name: string[]; position: number[]; velocity: number[] };
type PoseStamped = { pose: { position: XYZ; orientation: XYZW } };
type TwistStamped = { twist: { linear: XYZ; angular: XYZ } };
type WrenchStamped = { wrench: { force: XYZ; torque: XYZ } };
type Transforms = {
  transforms: {
    header: { frame_id: string };
    child_frame_id: string;
    transform: { translation: XYZ; rotation: XYZW };
  }[];
};

function posed(message: PoseStamped): Pose {
  return {
    position: vec(message.pose.position),
    orientation: quat(message.pose.orientation),
  };
}
