// 4x4 matrices, column by column as WebGL takes them, and quaternions [x, y, z, w].

export const identity = () => [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

export function multiply(a, b) {
  const out = new Array(16).fill(0);
  for (let column = 0; column < 4; column++) {
    for (let row = 0; row < 4; row++) {
      for (let k = 0; k < 4; k++) out[column * 4 + row] += a[k * 4 + row] * b[column * 4 + k];
    }
  }
  return out;
}

export const chain = (...matrices) => matrices.reduce(multiply);

export function translation([x, y, z]) {
  const m = identity();
  m[12] = x; m[13] = y; m[14] = z;
  return m;
}

export function scaling([x, y, z]) {
  const m = identity();
  m[0] = x; m[5] = y; m[10] = z;
  return m;
}

export function rotation([x, y, z, w]) {
  const n = Math.hypot(x, y, z, w) || 1;
  [x, y, z, w] = [x / n, y / n, z / n, w / n];
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w), 0,
    2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w), 0,
    2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y), 0,
    0, 0, 0, 1,
  ];
}

// Looks along -z; `vertical` is the whole angle of view in radians.
export function perspective(vertical, aspect, near, far) {
  const f = 1 / Math.tan(vertical / 2);
  const out = new Array(16).fill(0);
  out[0] = f / aspect; out[5] = f; out[11] = -1;
  out[10] = (far + near) / (near - far);
  out[14] = (2 * far * near) / (near - far);
  return out;
}

// A camera that circles a point: turn to the right, rise, distance.
export function orbit(yaw, pitch, distance, centre) {
  const turn = (axis, angle) => rotation([...axis.map((a) => a * Math.sin(angle / 2)), Math.cos(angle / 2)]);
  return chain(
    translation([0, 0, -distance]),
    turn([1, 0, 0], pitch),
    turn([0, 1, 0], -yaw),
    translation(centre.map((c) => -c)),
  );
}

// Yaw, pitch, roll in degrees of a head's quaternion in the sensor frame (x right, y down, z forward): turn to the left of
// the picture, nod, lean.
export function angles([x, y, z, w]) {
  const m = rotation([x, y, z, w]);
  const degrees = (a) => (a * 180) / Math.PI;
  return [
    degrees(Math.atan2(m[8], m[10])),
    degrees(Math.asin(Math.max(-1, Math.min(1, -m[9])))),
    degrees(Math.atan2(m[1], m[5])),
  ];
}
