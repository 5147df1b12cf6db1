// Unit vectors, quaternions (scalar last, ICRS to camera) and the camera: plain arrays, radians unless the name says degrees.

export const DEG = Math.PI / 180;
export const ARCSEC = DEG / 3600;

/** Rotation matrix (rows) of a quaternion [x, y, z, w]: camera = A · ICRS. */
export function matrixOf([x, y, z, w]) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)],
    [2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)],
    [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)],
  ];
}

export const turned = (a, v) => a.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
export const turnedBack = (a, v) => [0, 1, 2].map((k) => a[0][k] * v[0] + a[1][k] * v[1] + a[2][k] * v[2]);

/** Unit vector of right ascension and declination in degrees. */
export function directionOf(raDeg, decDeg) {
  const ra = raDeg * DEG, dec = decDeg * DEG;
  return [Math.cos(dec) * Math.cos(ra), Math.cos(dec) * Math.sin(ra), Math.sin(dec)];
}

/** Right ascension (0 to 360) and declination in degrees of a vector. */
export function radecOf([x, y, z]) {
  const ra = Math.atan2(y, x) / DEG;
  return [ra < 0 ? ra + 360 : ra, Math.atan2(z, Math.hypot(x, y)) / DEG];
}

/** Points of the circle of `radius` radians about the unit vector `axis`. */
export function circleAbout(axis, radius, count = 181) {
  const pole = Math.abs(axis[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0];
  const east = unit(cross(pole, axis)), north = cross(axis, east);
  return Array.from({ length: count }, (_, i) => {
    const turn = (2 * Math.PI * i) / (count - 1);
    const e = Math.sin(radius) * Math.cos(turn), n = Math.sin(radius) * Math.sin(turn), c = Math.cos(radius);
    return [0, 1, 2].map((k) => c * axis[k] + e * east[k] + n * north[k]);
  });
}

export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export function unit(v) {
  const length = Math.hypot(...v);
  return v.map((value) => value / length);
}

/** Distorted normalised coordinates: Brown and Conrady in OpenCV's order k1 k2 p1 p2 k3 k4 k5 k6. */
function distorted(x, y, k) {
  const r2 = x * x + y * y;
  const radial = (1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])));
  return [
    x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x),
    y * radial + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y,
  ];
}

/** Pixel ↔ direction in camera axes. The lens model is that of `welcome.camera`. */
export class Lens {
  constructor(camera) {
    Object.assign(this, { fx: camera.fx, fy: camera.fy, cx: camera.cx, cy: camera.cy });
    this.width = camera.width;
    this.height = camera.height;
    const given = camera.distortion ?? [];
    this.k = Array.from({ length: 8 }, (_, i) => given[i] ?? 0);
  }

  /** Pixel [x, y] of a vector in camera axes; null behind the camera or far outside the lens model. */
  pixelOf(v) {
    if (v[2] <= 1e-6) return null;
    const x = v[0] / v[2], y = v[1] / v[2];
    if (Math.abs(x * this.fx) > 2 * this.width || Math.abs(y * this.fy) > 2 * this.height) return null;
    const [xd, yd] = distorted(x, y, this.k);
    return [this.fx * xd + this.cx, this.fy * yd + this.cy];
  }

  /** Unit vector in camera axes of a pixel: fixed-point iteration, converged within 1e-9 for lenses of cameras. */
  directionOf(px, py) {
    const xd = (px - this.cx) / this.fx, yd = (py - this.cy) / this.fy;
    let x = xd, y = yd;
    for (let i = 0; i < 30; i++) {
      const [xt, yt] = distorted(x, y, this.k);
      x += xd - xt;
      y += yd - yt;
    }
    return unit([x, y, 1]);
  }

  /** The field's outline as unit vectors in camera axes, closed, `perSide` points a side. */
  outline(perSide = 8) {
    const left = -0.5, right = this.width - 0.5, top = -0.5, bottom = this.height - 0.5;
    const corners = [[left, top], [right, top], [right, bottom], [left, bottom], [left, top]];
    const points = [];
    for (let side = 0; side < 4; side++) {
      for (let i = 0; i < perSide; i++) {
        const t = i / perSide, [a, b] = [corners[side], corners[side + 1]];
        points.push(this.directionOf(a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])));
      }
    }
    return [...points, points[0]];
  }
}

/** Hammer projection, equal in area, right ascension growing to the left; both coordinates in units of the map's radius. */
export class Hammer {
  constructor(centreRaDeg) {
    this.centre = centreRaDeg;
  }

  /** [x, y] with |x| ≤ 2, |y| ≤ 1, y upwards. */
  of(v) {
    const [ra, dec] = radecOf(v);
    let lon = ((((ra - this.centre) % 360) + 540) % 360) - 180;
    lon *= DEG;
    const lat = dec * DEG, root = Math.sqrt(1 + Math.cos(lat) * Math.cos(lon / 2));
    return [(-2 * Math.cos(lat) * Math.sin(lon / 2)) / root, Math.sin(lat) / root];
  }

  /** Unit vector of a point of the map, null outside of it. */
  back(x, y) {
    const q = (x * x) / 4 + y * y;
    if (q > 1) return null;
    const z = Math.sqrt(1 - q / 2); // with x in units of √2 below
    const xs = x * Math.SQRT2, ys = y * Math.SQRT2;
    const lon = 2 * Math.atan2(z * xs, 2 * (2 * z * z - 1)), dec = Math.asin(Math.max(-1, Math.min(1, z * ys)));
    return directionOf(this.centre - lon / DEG, dec / DEG);
  }
}
