// What the page knows: the newest of each message, and bounded histories of error and path.

import { ARCSEC } from "./vectors.js";

const HISTORY = 30000; // frames; 10 minutes at 50 frames a second
const JUMP_STEPS = 30; // a longer step of time than so many frames is a jump, drawn as a short break

/** A ring of the newest `size` entries. */
export class Ring {
  constructor(size) {
    this.size = size;
    this.clear();
  }

  clear() {
    this.items = [];
    this.head = 0;
  }

  push(item) {
    if (this.items.length < this.size) this.items.push(item);
    else {
      this.items[this.head] = item;
      this.head = (this.head + 1) % this.size;
    }
  }

  get length() {
    return this.items.length;
  }

  /** Entry `i`, 0 being the oldest. */
  at(i) {
    return this.items[(this.head + i) % this.items.length];
  }

  last() {
    return this.length ? this.at(this.length - 1) : undefined;
  }
}

export class Store extends EventTarget {
  welcome = null;
  frame = null;
  solution = null;
  truth = null;
  state = null;
  link = { state: "connecting" };
  history = new Ring(HISTORY);
  #waiting = new Map();

  constructor(connection) {
    super();
    for (const type of ["welcome", "state", "link"]) {
      connection.addEventListener(type, ({ detail }) => this.#set(type, detail));
    }
    connection.addEventListener("frame", ({ detail }) => this.#set("frame", detail));
    connection.addEventListener("solution", ({ detail }) => {
      this.#set("solution", detail);
      this.#pair(detail, "solution");
    });
    connection.addEventListener("truth", ({ detail }) => {
      this.#set("truth", detail);
      this.#pair(detail, "truth");
    });
  }

  get solved() {
    return this.solution?.status === "solved";
  }

  get blinded() {
    return Boolean(this.truth?.blinded ?? this.state?.blinded);
  }

  #set(type, value) {
    this[type] = value;
    this.dispatchEvent(new Event(type));
  }

  /** A row of the history as soon as solution and truth of one frame are both here. */
  #pair(message, kind) {
    const other = this.#waiting.get(message.index);
    if (!other || other.kind === kind) {
      this.#waiting.set(message.index, { kind, message });
      if (this.#waiting.size > 64) this.#waiting.delete(this.#waiting.keys().next().value);
      return;
    }
    this.#waiting.delete(message.index);
    const solution = kind === "solution" ? message : other.message;
    const truth = kind === "truth" ? message : other.message;
    this.#append(solution, truth);
  }

  #append(solution, truth) {
    const last = this.history.last();
    const step = this.welcome?.step_s || 1;
    const since = last ? truth.t_s - last.t : 0;
    const jumped = Boolean(last) && (since < 0 || since > JUMP_STEPS * step);
    const solved = solution.status === "solved";
    const covariance = solution.covariance_rad2; // also while coasting: it grows
    this.history.push({
      t: truth.t_s,
      x: last ? last.x + (jumped ? 3 * step : since) : 0, // mission time without its jumps
      jumped,
      solved,
      blinded: Boolean(truth.blinded),
      error: solved ? truth.error_arcsec : null,
      bound: truth.bound_arcsec ?? null,
      stated: covariance ? covariance.map((row, i) => Math.sqrt(row[i]) / ARCSEC) : null,
      radec: solved ? [solution.ra_deg, solution.dec_deg] : null,
    });
    this.dispatchEvent(new Event("history"));
  }
}
