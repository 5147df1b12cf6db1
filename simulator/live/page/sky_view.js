// The whole sky: brightest stars, boresight path and field, Sun, Moon, Earth's disc, and the zones in which they blind.

import { FONT, SMALL, Surface, colour, label, rgbOf } from "./canvas.js";
import { degrees, fixed, hours } from "./format.js";
import { Ring } from "./state.js";
import { DEG, Hammer, Lens, circleAbout, directionOf, dot, matrixOf, turnedBack, unit } from "./vectors.js";

const PATH = 4000, PATH_STEP_DEG = 0.05, NAMED_MAGNITUDE = 1.25, OBLIQUITY_DEG = 23.4393, MARGIN = 4;
const INTERVAL_MS = 100;

export class SkyView {
  #path = new Ring(PATH);
  #hammer = new Hammer(180);
  #turned = false;
  #zones = { key: "", caps: document.createElement("canvas"), disc: document.createElement("canvas") };
  #stars = [];
  #lines = [];
  #outline = null;

  constructor(store) {
    this.store = store;
    this.canvas = document.getElementById("sky");
    this.surface = new Surface(this.canvas, (context, w, h) => this.#draw(context, w, h), INTERVAL_MS);
    store.addEventListener("welcome", () => {
      this.lens = new Lens(store.welcome.camera);
      this.#outline = this.lens.outline();
    });
    store.addEventListener("truth", () => this.#follow());
    this.canvas.addEventListener("keydown", (event) => this.#key(event));
    this.canvas.addEventListener("pointerdown", (event) => this.#drag(event));
    this.#load();
  }

  async #load() {
    const reply = await fetch("sky.json");
    if (!reply.ok) return;
    const sky = await reply.json();
    this.#stars = sky.stars.map((star) => ({ ...star, direction: directionOf(star.ra_deg, star.dec_deg) }));
    this.#lines = sky.lines.map((line) => line.map(([ra, dec]) => directionOf(ra, dec)));
    this.surface.request();
  }

  #follow() {
    const truth = this.store.truth, boresight = turnedBack(matrixOf(truth.quaternion), [0, 0, 1]);
    const last = this.#path.last();
    if (!last || dot(last, boresight) < Math.cos(PATH_STEP_DEG * DEG)) this.#path.push(boresight);
    if (!this.#turned) this.#centreOn(Math.atan2(boresight[1], boresight[0]) / DEG);
    this.surface.request();
  }

  #centreOn(raDeg) {
    this.#turned = true;
    this.#hammer = new Hammer((((Math.round(raDeg / 15) * 15) % 360) + 360) % 360);
    this.surface.request();
  }

  #key(event) {
    const move = { ArrowLeft: 15, ArrowRight: -15 }[event.key];
    if (!move) return;
    event.preventDefault();
    this.#centreOn(this.#hammer.centre + move);
  }

  #drag(event) {
    const from = event.clientX, centre = this.#hammer.centre, move = new AbortController();
    this.canvas.setPointerCapture(event.pointerId);
    this.canvas.addEventListener("pointermove", (now) => {
      this.#centreOn(centre + ((now.clientX - from) / this.surface.width) * 360);
    }, { signal: move.signal });
    for (const end of ["pointerup", "pointercancel"]) this.canvas.addEventListener(end, () => move.abort(), { signal: move.signal });
  }

  #draw(context, width, height) {
    const radius = Math.min((width - 2 * MARGIN) / 4, (height - 2 * MARGIN) / 2);
    const at = (v) => {
      const [x, y] = this.#hammer.of(v);
      return [width / 2 + x * radius, height / 2 - y * radius];
    };
    context.save();
    context.beginPath();
    context.ellipse(width / 2, height / 2, 2 * radius, radius, 0, 0, 2 * Math.PI);
    context.fillStyle = colour("sky");
    context.fill();
    context.clip();
    this.#drawZones(context, width, height, radius);
    this.#graticule(context, at, radius);
    this.#drawStars(context, at, radius);
    if (this.store.truth) context.drawImage(this.#zones.disc, 0, 0);
    this.#hours(context, at);
    context.restore();
    context.strokeStyle = colour("edge");
    context.lineWidth = 1;
    context.beginPath();
    context.ellipse(width / 2, height / 2, 2 * radius, radius, 0, 0, 2 * Math.PI);
    context.stroke();
    if (this.store.truth) {
      this.#bodies(context, at, radius);
      this.#boresight(context, at, radius);
      this.#tell();
    }
  }

  /** Filled caps of the exclusion zones and of the Earth, which hides the stars; painted when something has moved. */
  #drawZones(context, width, height, radius) {
    const truth = this.store.truth;
    if (!truth) return;
    const caps = capsOf(truth);
    const near = caps.map((cap) => cap.axis.map((value) => value.toFixed(3))).join();
    const key = [near, this.#hammer.centre, width, height, colour("sky")].join();
    if (key !== this.#zones.key) {
      this.#zones.key = key;
      for (const [layer, shown] of [[this.#zones.caps, caps.filter((cap) => !cap.disc)], [this.#zones.disc, caps.filter((cap) => cap.disc)]]) {
        layer.width = Math.ceil(width);
        layer.height = Math.ceil(height);
        paintCaps(layer.getContext("2d"), shown, this.#hammer, radius);
      }
    }
    context.drawImage(this.#zones.caps, 0, 0);
  }

  #graticule(context, at, radius) {
    const jump = radius;
    context.lineWidth = 0.7;
    context.strokeStyle = colour("line");
    for (let dec = -60; dec <= 60; dec += 30) polyline(context, arc(361, (i) => directionOf(i, dec)), at, jump);
    for (let ra = 0; ra < 360; ra += 45) polyline(context, arc(89, (i) => directionOf(ra, 2 * i - 88)), at, jump);
    context.setLineDash([4, 4]);
    context.strokeStyle = colour("edge");
    const tilt = OBLIQUITY_DEG * DEG;
    const ecliptic = arc(361, (i) => [Math.cos(i * DEG), Math.sin(i * DEG) * Math.cos(tilt), Math.sin(i * DEG) * Math.sin(tilt)]);
    polyline(context, ecliptic, at, jump);
    context.setLineDash([]);
  }

  #hours(context, at) {
    context.font = SMALL;
    context.textAlign = "center";
    context.textBaseline = "middle";
    for (let k = -3; k <= 3; k++) {
      const hour = (((Math.round(this.#hammer.centre / 15) + 3 * k) % 24) + 24) % 24;
      const [x, y] = at(directionOf(this.#hammer.centre + 45 * k, 0));
      label(context, `${hour}h`, x, y + 9, colour("soft"), colour("sky"));
    }
    context.textAlign = "left";
  }

  #drawStars(context, at, radius) {
    const size = Math.max(0.7, Math.min(1.25, radius / 160));
    context.strokeStyle = colour("edge");
    context.globalAlpha = 0.45;
    context.lineWidth = 0.7;
    for (const line of this.#lines) polyline(context, line, at, radius);
    context.globalAlpha = 1;
    const dark = getComputedStyle(document.documentElement).colorScheme === "dark" || rgbOf("sky")[0] < 128;
    for (const star of this.#stars) {
      const [x, y] = at(star.direction);
      context.fillStyle = dark ? star.colour : colour("sky-star");
      context.beginPath();
      context.arc(x, y, size * Math.max(0.5, 2.4 - 0.42 * star.magnitude), 0, 2 * Math.PI);
      context.fill();
    }
    if (radius < 130) return;
    context.font = SMALL;
    context.textBaseline = "middle";
    for (const star of this.#stars) {
      if (star.magnitude > NAMED_MAGNITUDE || !star.name) continue;
      const [x, y] = at(star.direction);
      label(context, star.name, x + 5, y, colour("soft"), colour("sky"));
    }
  }

  #bodies(context, at, radius) {
    const { truth } = this.store;
    context.lineWidth = 1.4;
    for (const cap of capsOf(truth)) {
      context.strokeStyle = colour(cap.line);
      context.setLineDash(cap.dash);
      polyline(context, circleAbout(cap.axis, cap.radius), at, radius);
    }
    context.setLineDash([]);
    context.font = `600 ${FONT}`;
    context.textBaseline = "middle";
    const taken = [];
    for (const [name, direction, size] of [["Sun", truth.sun, 6], ["Moon", truth.moon, 5], ["Earth", truth.earth, 0]]) {
      if (!direction) continue;
      const [x, y] = at(direction), hidden = size > 0 && this.#hidden(direction);
      context.fillStyle = context.strokeStyle = colour(name === "Sun" ? "orange" : "soft");
      context.beginPath();
      context.arc(x, y, size, 0, 2 * Math.PI);
      if (hidden) context.stroke();
      else context.fill();
      const text = hidden ? `${name}, hidden` : name, long = context.measureText(text).width;
      const beside = x + 10 + long > this.surface.width ? x - 10 - long : x + 10, left = size ? beside : x - long / 2;
      let row = y;
      while (taken.some(([l, r, v]) => l < left + long && left < r && Math.abs(v - row) < 15)) row += 16;
      taken.push([left, left + long, row]);
      label(context, text, left, row, colour("text"), colour("sky"));
    }
  }

  /** Whether a direction is behind the Earth. */
  #hidden(direction) {
    const { earth, earth_radius_deg: radiusDeg } = this.store.truth;
    return Boolean(earth) && dot(direction, earth) > Math.cos(radiusDeg * DEG);
  }

  #boresight(context, at, radius) {
    const attitude = matrixOf(this.store.truth.quaternion), boresight = turnedBack(attitude, [0, 0, 1]);
    context.strokeStyle = colour("vermilion");
    context.lineWidth = 1.6;
    const path = arc(this.#path.length, (i) => this.#path.at(i));
    polyline(context, [...path, boresight], at, radius, Math.cos(3 * DEG));
    if (this.#outline) polyline(context, this.#outline.map((v) => turnedBack(attitude, v)), at, radius);
    const [x, y] = at(boresight);
    context.lineWidth = 2;
    context.beginPath();
    for (const [u, v] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
      context.moveTo(x + 4 * u, y + 4 * v);
      context.lineTo(x + 10 * u, y + 10 * v);
    }
    context.stroke();
  }

  /** The distances in words, for all and for a screen reader. */
  #tell() {
    const { truth } = this.store, boresight = turnedBack(matrixOf(truth.quaternion), [0, 0, 1]);
    const away = (v) => (v ? `${fixed(Math.acos(Math.max(-1, Math.min(1, dot(boresight, v)))) / DEG, 1)}°` : "–");
    const [ra, dec] = [((Math.atan2(boresight[1], boresight[0]) / DEG) + 360) % 360, Math.asin(boresight[2]) / DEG];
    const inTheWay = truth.excluded.length ? ` · in the way: ${truth.excluded.join(", ")}` : "";
    const limb = truth.earth ? Math.acos(Math.max(-1, Math.min(1, dot(boresight, truth.earth)))) / DEG - truth.earth_radius_deg : NaN;
    const text = `True boresight RA ${hours(ra, 0)}, Dec ${degrees(dec)} · Sun ${away(truth.sun)} · Moon ${away(truth.moon)} · Earth's limb ${fixed(limb, 1)}°${inTheWay}`;
    const output = document.getElementById("sky-text");
    if (output.textContent !== text) output.textContent = text;
  }
}

/** Caps to shade, the lowest first: axis, radius in radians, colours. */
function capsOf(truth) {
  const zones = truth.exclusions ?? {}, caps = [];
  const add = (axis, radiusDeg, fill, line, dash) => {
    if (axis && radiusDeg > 0) caps.push({ axis: unit(axis), radius: Math.min(radiusDeg, 180) * DEG, fill, line, dash, disc: fill === "earth" });
  };
  if (zones.earth_deg > 0) add(truth.earth, truth.earth_radius_deg + zones.earth_deg, "zone-earth", "blue", [4, 3]);
  add(truth.moon, zones.moon_deg, "zone-moon", "soft", [2, 3]);
  add(truth.sun, zones.sun_deg, "zone-sun", "orange", [6, 3]);
  add(truth.earth, truth.earth_radius_deg, "earth", "blue", []);
  return caps;
}

function paintCaps(context, caps, hammer, radius) {
  const { width, height } = context.canvas, image = context.createImageData(width, height), data = image.data;
  const soft = 1.2 / radius; // edges one pixel wide
  const colours = caps.map((cap) => rgbOf(cap.fill));
  for (let row = 0, p = 0; row < height; row++) {
    for (let column = 0; column < width; column++, p += 4) {
      const v = hammer.back((column + 0.5 - width / 2) / radius, (height / 2 - row - 0.5) / radius);
      if (!v) continue;
      for (let k = 0; k < caps.length; k++) {
        const inside = (caps[k].radius - Math.acos(Math.max(-1, Math.min(1, dot(v, caps[k].axis))))) / soft + 0.5;
        if (inside <= 0) continue;
        const share = Math.min(1, inside), old = data[p + 3] / 255, whole = share + old * (1 - share);
        for (let c = 0; c < 3; c++) data[p + c] = (colours[k][c] * share + data[p + c] * old * (1 - share)) / whole;
        data[p + 3] = 255 * whole;
      }
    }
  }
  context.putImageData(image, 0, 0);
}

const arc = (count, point) => Array.from({ length: count }, (_, i) => point(i));

/** A line over the map, broken at its edge and, with `leastCos`, where successive points are farther apart. */
function polyline(context, directions, at, jump, leastCos = -1) {
  let before = null, beforeDirection = null;
  context.beginPath();
  for (const direction of directions) {
    const here = at(direction);
    const joined = before && Math.hypot(here[0] - before[0], here[1] - before[1]) < jump && dot(direction, beforeDirection) >= leastCos;
    if (joined) context.lineTo(...here);
    else context.moveTo(...here);
    [before, beforeDirection] = [here, direction];
  }
  context.stroke();
}
