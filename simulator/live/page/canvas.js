// A canvas that draws on animation frames alone, in the device's own pixels and in the theme's colours.

const probe = document.createElement("span");
probe.hidden = true;
document.documentElement.append(probe);
let cache = new Map();

/** Colour of a variable of theme.css as the browser resolves it in the present theme. */
export function colour(name) {
  if (!cache.has(name)) {
    probe.style.color = `var(--${name})`;
    cache.set(name, getComputedStyle(probe).color);
  }
  return cache.get(name);
}

/** Components 0 … 255 of a theme's colour. */
export const rgbOf = (name) => colour(name).match(/[\d.]+/g).slice(0, 3).map(Number);

const surfaces = new Set();

/** After a change of theme: forget the colours and draw everything again. */
export function recolour() {
  cache = new Map();
  for (const surface of surfaces) surface.request();
}

export class Surface {
  /**
   * @param canvas the element
   * @param draw called with (context, width, height) in CSS pixels
   * @param interval least milliseconds between two drawings
   */
  constructor(canvas, draw, interval = 0) {
    Object.assign(this, { canvas, draw, interval, drawn: -interval, width: 0, height: 0, ratio: 1, waiting: false });
    this.context = canvas.getContext("2d");
    new ResizeObserver(() => this.request()).observe(canvas);
    surfaces.add(this);
  }

  /** Draw on the next animation frame; further calls until then are one. */
  request() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame((now) => {
      this.waiting = false;
      if (now - this.drawn < this.interval) return this.request();
      this.drawn = now;
      this.#fit();
      if (this.width < 8 || this.height < 8) return;
      this.context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
      this.context.clearRect(0, 0, this.width, this.height);
      this.draw(this.context, this.width, this.height);
      return undefined;
    });
  }

  #fit() {
    const box = this.canvas.getBoundingClientRect();
    this.ratio = window.devicePixelRatio || 1;
    this.width = this.canvas.clientWidth || box.width;
    this.height = this.canvas.clientHeight || box.height;
    const [w, h] = [Math.round(this.width * this.ratio), Math.round(this.height * this.ratio)];
    if (this.canvas.width !== w) this.canvas.width = w;
    if (this.canvas.height !== h) this.canvas.height = h;
  }
}

/** Text with a halo in `halo`, legible over anything. */
export function label(context, text, x, y, front, halo) {
  context.lineJoin = "round";
  context.lineWidth = 3;
  context.strokeStyle = halo;
  context.strokeText(text, x, y);
  context.fillStyle = front;
  context.fillText(text, x, y);
}

export const FONT = '12px system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif';
export const SMALL = '11px system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif';
