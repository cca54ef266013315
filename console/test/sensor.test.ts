import assert from "node:assert/strict";
import { test } from "node:test";
import { ending } from "../src/panels/sensors.ts";
import { SENSORS } from "../src/sensor.ts";

const IMU = {
  orientation: { x: Math.SQRT1_2, y: 0, z: 0, w: Math.SQRT1_2 },
  orientation_covariance: [0, 0, 0, 0, 0, 0, 0, 0, 0],
  angular_velocity: { x: Math.PI, y: 0, z: 0 },
  angular_velocity_covariance: [-1, 0, 0, 0, 0, 0, 0, 0, 0],
  linear_acceleration: { x: 0, y: 0, z: 9.81 },
  linear_acceleration_covariance: [0, 0, 0, 0, 0, 0, 0, 0, 0],
};

test("an IMU shows what it measures, and nothing for what it does not", () => {
  const [acceleration, turning, orientation] = SENSORS["sensor_msgs/msg/Imu"] ?? [];
  assert.deepEqual(acceleration?.values(IMU), [0, 0, 9.81]);
  assert.deepEqual(turning?.values(IMU), [null, null, null]);
  assert.deepEqual(
    orientation?.values(IMU).map((each) => Math.round(each ?? NaN)),
    [90, 0, 0],
  );
});

test("a wrench is a force and a torque", () => {
  const [force, torque] = SENSORS["geometry_msgs/msg/WrenchStamped"] ?? [];
  const message = { wrench: { force: { x: 1, y: 2, z: 3 }, torque: { x: 4, y: 5, z: 6 } } };
  assert.deepEqual(force?.values(message), [1, 2, 3]);
  assert.deepEqual(torque?.values(message), [4, 5, 6]);
  assert.deepEqual(force?.names, ["Fx", "Fy", "Fz"]);
});

test("a sound is kept under the ending of its kind", () => {
  assert.equal(ending("audio/webm;codecs=opus"), "webm");
  assert.equal(ending("audio/mp4"), "mp4");
  assert.equal(ending(""), "audio");
});
