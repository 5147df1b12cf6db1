// A display pixel by pixel, and the schedule by which its pictures appear. Neither knows of the server.

const MESSAGES = 20;

/** Draws lit pixels on black, one canvas pixel on one display pixel. */
export class Screen {
  #context;
  #image = null;
  #lit = [];

  constructor(canvas) {
    this.canvas = canvas;
    this.#context = canvas.getContext("2d", { alpha: false, willReadFrequently: false });
  }

  /** Size in display pixels; the page's zoom and the display's scale factor do not change it. */
  resize(width, height) {
    const { canvas } = this;
    if (canvas.width !== width || canvas.height !== height || !this.#image) {
      canvas.width = width;
      canvas.height = height;
      this.#image = this.#context.createImageData(width, height);
      this.#image.data.fill(0);
      for (let at = 3; at < this.#image.data.length; at += 4) this.#image.data[at] = 255;
      this.#lit = [];
    }
    canvas.style.width = `${width / devicePixelRatio}px`;
    canvas.style.height = `${height / devicePixelRatio}px`;
  }

  /** Show a picture's lit pixels, eight bytes each (column, row, red, green, blue, 0); all others become black. */
  show({ data: bytes, first, pixels }) {
    const { data, width, height } = this.#image, view = new DataView(bytes, 8 * first, 8 * pixels);
    for (const at of this.#lit) data[at] = data[at + 1] = data[at + 2] = 0;
    this.#lit = [];
    for (let n = 0; n < 8 * pixels; n += 8) {
      const x = view.getUint16(n, true), y = view.getUint16(n + 2, true);
      if (x >= width || y >= height) continue;
      const at = 4 * (y * width + x);
      for (let c = 0; c < 3; c += 1) data[at + c] = view.getUint8(n + 4 + c);
      this.#lit.push(at);
    }
    this.#context.putImageData(this.#image, 0, 0);
  }
}

/** Which picture is due, by the times of the messages and the time of each refresh; late ones are counted.
 *
 * The mission's clock is that of the message that took least time to arrive, of the last twenty. Pictures are shown `delayMs` after it, so
 * that messages may differ by so much in the time they take. */
export class Schedule {
  #queue = [];
  #starts = [];
  #delay = 0;
  #speed = 0;
  #last = -Infinity;

  constructor({ delayMs = 50 } = {}) {
    Object.assign(this, { delayMs, shown: 0, late: 0, skipped: 0, index: -1 });
  }

  /** Take a message `stimulus` that arrived at a time, ms. */
  add(message, nowMs) {
    const start = nowMs - (1000 * message.t_s) / message.speed;
    if (!message.paced || message.speed !== this.#speed || message.t_s <= this.#last) {
      this.#starts = [];
      this.#queue = [];
    }
    this.#starts.push(start);
    if (this.#starts.length > MESSAGES) this.#starts.shift();
    this.#delay = message.paced ? this.delayMs : 0;
    this.#speed = message.speed;
    this.#last = message.t_s;
    let first = 0;
    for (const picture of message.pictures) {
      this.#queue.push({ ...picture, first, data: message.data, index: message.index });
      first += picture.pixels;
    }
  }

  #due(picture) {
    return Math.min(...this.#starts) + (1000 * picture.t_s) / this.#speed + this.#delay;
  }

  /** The newest picture that is due at a refresh, null if there is no new one; `periodMs` is that of the display. */
  next(nowMs, periodMs) {
    let found = null, dropped = 0;
    while (this.#queue.length && this.#due(this.#queue[0]) <= nowMs + periodMs / 2) {
      if (found && nowMs - this.#due(found) > 1.5 * periodMs) this.late += 1;
      else dropped += Number(Boolean(found));
      found = this.#queue.shift();
    }
    if (!found) return null;
    if (nowMs - this.#due(found) > 1.5 * periodMs) this.late += 1;
    this.skipped += dropped;
    this.shown += 1;
    this.index = found.index;
    return found;
  }
}
