import type { Message } from "./rosbridge.ts";
import { DEGREE, type Quat, rotationVector } from "./spatial.ts";

type XYZ = { x: number; y: number; z: number };

/** What of a sensor's messages can be drawn. */
export type Quantity = {
  key: string;
  label: "plotForce" | "plotTorque" | "plotAcceleration" | "plotTurning" | "plotOrientation";
  names: readonly string[];
  values: (message: Message) => (number | null)[];
};

const three = ({ x, y, z }: XYZ) => [x, y, z];
const named = (letter: string) => ["x", "y", "z"].map((axis) => `${letter}${axis}`);

/** An IMU that does not measure something says so: the first number of its covariance is -1. */
function measured(message: Message, what: string): boolean {
  return (message[`${what}_covariance`] as number[] | undefined)?.[0] !== -1;
}

const ofImu = (what: string, values: (message: Message) => number[]) => (message: Message) =>
  measured(message, what) ? values(message) : [null, null, null];

type Wrench = { force: XYZ; torque: XYZ };

export const SENSORS: Record<string, readonly Quantity[]> = {
  "geometry_msgs/msg/WrenchStamped": [
    {
      key: "force",
      label: "plotForce",
      names: named("F"),
      values: (message) => three((message["wrench"] as Wrench).force),
    },
    {
      key: "torque",
      label: "plotTorque",
      names: named("M"),
      values: (message) => three((message["wrench"] as Wrench).torque),
    },
  ],
  "sensor_msgs/msg/Imu": [
    {
      key: "acceleration",
      label: "plotAcceleration",
      names: named("a"),
      values: ofImu("linear_acceleration", (message) => three(message["linear_acceleration"] as XYZ)),
    },
    {
      key: "turning",
      label: "plotTurning",
      names: named("ω"),
      values: ofImu("angular_velocity", (message) =>
        three(message["angular_velocity"] as XYZ).map((each) => each / DEGREE),
      ),
    },
    {
      key: "orientation",
      label: "plotOrientation",
      names: named("r"),
      values: ofImu("orientation", (message) => {
        const { x, y, z, w } = message["orientation"] as XYZ & { w: number };
        const turn: Quat = [x, y, z, w];
        return rotationVector(turn).map((each) => each / DEGREE);
      }),
    },
  ],
};
