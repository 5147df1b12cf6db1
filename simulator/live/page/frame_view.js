// The live frame: pixels, detections, identified stars with names, the solved grid, and what lies under the cursor.

import { FONT, Surface, label } from "./canvas.js";
import { degrees, fixed, hours, words } from "./format.js";
import { drawGrid } from "./grid.js";
import { levelsOf, pixelsOf, tableOf } from "./stretch.js";
import { Lens, matrixOf, radecOf, turnedBack } from "./vectors.js";

const ZOOMS = [1, 2, 4, 8], NAMES = 14, MOST_DETECTIONS = 400, HALO = "rgb(5 7 10 / 0.85)";
const SHOWN = ["stars", "names", "detections", "grid"];

export class FrameView {
  show = { stars: true, names: true, detections: true, grid: true };
  #zoom = 1;
  #cursor = null;
  #held = null;
  #fresh = false;
  #pixels = null;
  #size = [0, 0];
  #focus = null;
  #image = null;
  #words = null;
  #picture = document.createElement("canvas");

  constructor(store) {
    this.store = store;
    this.canvas = document.getElementById("frame");
    this.surface = new Surface(this.canvas, (context, width, height) => this.#draw(context, width, height));
    store.addEventListener("welcome", () => this.#welcome());
    store.addEventListener("frame", () => {
      this.#fresh = true;
      this.surface.request();
    });
    for (const type of ["solution", "truth", "link"]) store.addEventListener(type, () => this.surface.request());
    for (const name of SHOWN) document.getElementById(`show-${name}`).addEventListener("click", () => this.toggle(name));
    document.getElementById("hold").addEventListener("click", () => this.toggleHold());
    document.getElementById("zoom").addEventListener("click", () => this.zoom());
    this.canvas.addEventListener("pointermove", (event) => this.#point(event));
    this.canvas.addEventListener("dblclick", (event) => {
      this.#point(event);
      this.zoom();
    });
    this.canvas.addEventListener("keydown", (event) => this.#key(event));
  }

  toggle(name) {
    this.show[name] = !this.show[name];
    document.getElementById(`show-${name}`).setAttribute("aria-pressed", this.show[name]);
    this.surface.request();
  }

  /** Keep the scale of brightness, or fit it to every frame. */
  toggleHold() {
    this.#held = this.#held ? null : this.#pixels && levelsOf(this.#pixels, this.#saturation);
    document.getElementById("hold").setAttribute("aria-pressed", Boolean(this.#held));
    this.#fresh = true;
    this.surface.request();
  }

  /** The next magnification, about the cursor. */
  zoom() {
    this.#zoom = ZOOMS[(ZOOMS.indexOf(this.#zoom) + 1) % ZOOMS.length];
    document.getElementById("zoom").textContent = `Zoom ${this.#zoom}×`;
    this.surface.request();
  }

  #welcome() {
    this.lens = new Lens(this.store.welcome.camera);
    this.canvas.style.aspectRatio = `${this.lens.width} / ${this.lens.height}`;
    this.surface.request();
  }

  /** Left, top and side of the visible part, in pixels of the detector. */
  #window() {
    const { width, height } = this.lens;
    const w = width / this.#zoom, h = height / this.#zoom;
    const [x, y] = this.#focus ?? [width / 2, height / 2];
    return [Math.min(Math.max(x - w / 2, 0), width - w) - 0.5, Math.min(Math.max(y - h / 2, 0), height - h) - 0.5, w, h];
  }

  #point(event) {
    if (!this.lens) return;
    const box = this.canvas.getBoundingClientRect(), [left, top, w, h] = this.#window();
    const x = left + ((event.clientX - box.left) / box.width) * w, y = top + ((event.clientY - box.top) / box.height) * h;
    this.#moveTo(x, y, event.type === "dblclick");
  }

  #key(event) {
    const move = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (!move || !this.lens) return;
    event.preventDefault();
    const step = event.shiftKey ? 1 : Math.max(1, Math.round(this.lens.width / this.#zoom / 48));
    const [x, y] = this.#cursor ?? [this.lens.width / 2, this.lens.height / 2];
    this.#moveTo(x + step * move[0], y + step * move[1], true);
  }

  #moveTo(x, y, centre) {
    const { width, height } = this.lens;
    this.#cursor = [Math.min(Math.max(Math.round(x), 0), width - 1), Math.min(Math.max(Math.round(y), 0), height - 1)];
    if (centre || !this.#focus || this.#zoom === 1) this.#focus = this.#cursor;
    this.surface.request();
  }

  #draw(context, width, height) {
    if (!this.lens) return;
    if (this.#fresh) this.#develop();
    const [left, top, w, h] = this.#window(), scale = width / w;
    const at = (x, y) => [(x - left) * scale, (y - top) * scale];
    if (this.store.blinded) cover(context, width, height);
    else if (this.#pixels) {
      context.imageSmoothingEnabled = scale < 2;
      context.imageSmoothingQuality = "high";
      context.drawImage(this.#picture, left + 0.5, top + 0.5, w, h, 0, 0, width, height);
    }
    const { solution, frame } = this.store;
    const current = solution && frame && Math.abs(solution.index - frame.index) <= 1 && !this.store.blinded;
    context.font = FONT;
    if (current && this.store.solved && this.show.grid) drawGrid(context, matrixOf(solution.quaternion), this.lens, at, [width, height]);
    const marked = this.show.stars ? solution?.stars ?? [] : [];
    if (current && this.show.detections) this.#detections(context, others(solution.detections, marked), at);
    if (current && (this.show.stars || this.show.names)) this.#stars(context, solution.stars, at, width);
    this.#crosshair(context, at);
    this.#veil();
  }

  get #saturation() {
    return this.store.welcome.camera.saturation_dn;
  }

  /** Pixels of the newest frame to the picture. */
  #develop() {
    this.#fresh = false;
    const frame = this.store.frame;
    const pixels = frame && pixelsOf(frame);
    if (!pixels) return;
    this.#pixels = pixels;
    if (this.#picture.width !== frame.width || this.#picture.height !== frame.height) {
      Object.assign(this.#picture, { width: frame.width, height: frame.height });
      this.#image = new ImageData(frame.width, frame.height);
      this.#words = new Uint32Array(this.#image.data.buffer);
    }
    const table = tableOf(this.#held ?? levelsOf(pixels, this.#saturation)), out = this.#words;
    for (let i = 0; i < pixels.length; i++) out[i] = table[pixels[i]];
    this.#picture.getContext("2d").putImageData(this.#image, 0, 0);
    this.#size = [frame.width, frame.height];
  }

  #detections(context, detections, at) {
    context.beginPath();
    for (const [x, y] of detections.slice(0, MOST_DETECTIONS)) {
      const [u, v] = at(x, y);
      context.rect(u - 6, v - 6, 12, 12);
    }
    outlined(context, "#e69f00", 1.4);
  }

  #stars(context, stars, at, width) {
    context.beginPath();
    const brightest = [...stars].sort((a, b) => a.magnitude - b.magnitude);
    if (this.show.stars) {
      for (const star of stars) {
        const [u, v] = at(star.x, star.y);
        context.moveTo(u + 11, v);
        context.arc(u, v, 11, 0, 2 * Math.PI);
      }
    }
    outlined(context, "#56b4e9", 1.8);
    if (!this.show.names) return;
    const taken = [];
    context.textBaseline = "middle";
    for (const star of brightest.slice(0, NAMES)) {
      const text = star.name || `${star.id}`, [u, v] = at(star.x, star.y), long = context.measureText(text).width;
      const x = u + 15 + long > width ? u - 15 - long : u + 15;
      if (taken.some((b) => Math.abs(b[1] - v) < 15 && x < b[2] && x + long > b[0])) continue;
      taken.push([x, v, x + long]);
      label(context, text, x, v, star.name ? "#e6edf3" : "#b4c0cc", HALO);
    }
  }

  #crosshair(context, at) {
    const output = document.getElementById("cursor");
    if (!this.#cursor || !this.#pixels) return;
    const [x, y] = this.#cursor, [u, v] = at(x, y);
    context.strokeStyle = "rgb(230 237 243 / 0.8)";
    context.lineWidth = 1;
    context.beginPath();
    for (const [du, dv] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
      context.moveTo(u + 5 * du, v + 5 * dv);
      context.lineTo(u + 14 * du, v + 14 * dv);
    }
    context.stroke();
    const dn = this.#pixels[y * this.#size[0] + x];
    let text = `x ${x}, y ${y}: ${dn} DN`;
    if (this.store.solved) {
      const sky = turnedBack(matrixOf(this.store.solution.quaternion), this.lens.directionOf(x, y));
      const [ra, dec] = radecOf(sky);
      text += ` · RA ${hours(ra, 1)}, Dec ${degrees(dec)} (${fixed(ra, 4)}°, ${fixed(dec, 4)}°)`;
    }
    if (output.textContent !== text) output.textContent = text;
  }

  /** Words over the frame when it has no solution, or is not live. */
  #veil() {
    const { link, solution } = this.store, veil = document.getElementById("veil");
    let text = "";
    if (link.state !== "open") text = this.#pixels ? "Not live: the last frame before the connection was lost" : "";
    else if (this.store.blinded) text = "Blinded: the camera delivers no frames";
    else if (solution && !this.store.solved) text = `Lost: ${words(solution.reason || solution.status)}`;
    veil.hidden = !text;
    if (veil.textContent !== text) veil.textContent = text;
  }
}

/** Stroke of the path with a dark edge, to be seen on a bright frame too. */
function outlined(context, colour, width) {
  for (const [style, wide] of [["rgb(5 7 10 / 0.55)", width + 2], [colour, width]]) {
    context.strokeStyle = style;
    context.lineWidth = wide;
    context.stroke();
  }
}

/** Detections other than those marked as stars. */
function others(detections, stars) {
  return detections.filter(([x, y]) => !stars.some((star) => Math.abs(star.x - x) < 1 && Math.abs(star.y - y) < 1));
}

/** A covered camera: hatched, so that it is not taken for a dark sky. */
function cover(context, width, height) {
  context.fillStyle = "#11161c";
  context.fillRect(0, 0, width, height);
  context.strokeStyle = "#2b333c";
  context.lineWidth = 6;
  context.beginPath();
  for (let x = -height; x < width; x += 28) {
    context.moveTo(x, height);
    context.lineTo(x + height, 0);
  }
  context.stroke();
}
