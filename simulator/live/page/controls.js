// Sliders of the parameters that the server offers: position, number, unit; what the server says is what is shown.

import { significant, words } from "./format.js";

const STEPS = 1000, DECADES_TO_ZERO = 6, SEND_MS = 120;

export class Controls {
  #sliders = new Map();
  #first = new Map();

  constructor(store, connection) {
    Object.assign(this, { store, connection, form: document.getElementById("sliders") });
    this.form.addEventListener("submit", (event) => event.preventDefault());
    store.addEventListener("welcome", () => this.#build(store.welcome.parameters));
    store.addEventListener("state", () => this.#follow(store.state.parameters ?? {}));
    store.addEventListener("link", () => this.#enable(store.link.state === "open"));
    document.getElementById("reset").addEventListener("click", () => this.reset());
  }

  /** All parameters as they were when the page first met the server. */
  reset() {
    for (const [path, slider] of this.#sliders) {
      if (slider.value !== this.#first.get(path)) slider.ask(this.#first.get(path));
    }
  }

  #build(parameters) {
    this.form.replaceChildren();
    this.#sliders.clear();
    const groups = new Map();
    for (const parameter of parameters) {
      const name = parameter.group;
      if (!groups.has(name)) groups.set(name, this.#group(name));
      const slider = new Slider(parameter, (value) => this.connection.request({ type: "set", path: parameter.path, value }));
      groups.get(name).append(slider.element);
      this.#sliders.set(parameter.path, slider);
      if (!this.#first.has(parameter.path)) this.#first.set(parameter.path, parameter.value);
    }
  }

  #group(name) {
    const group = document.createElement("fieldset"), legend = document.createElement("legend");
    legend.textContent = words(name);
    group.append(legend);
    this.form.append(group);
    return group;
  }

  #follow(values) {
    for (const [path, value] of Object.entries(values)) this.#sliders.get(path)?.follow(value);
  }

  #enable(on) {
    for (const slider of this.#sliders.values()) slider.enable(on);
    document.getElementById("reset").disabled = !on;
  }
}

class Slider {
  #timer = 0;
  #asked = null;
  #sending = 0;

  constructor(parameter, send) {
    Object.assign(this, { parameter, send, scale: scaleOf(parameter), value: parameter.value });
    const id = `p-${parameter.path.replaceAll(/[^a-zA-Z0-9]/g, "-")}`;
    this.element = document.createElement("div");
    this.element.className = "slider";
    this.element.dataset.path = parameter.path;
    const name = document.createElement("label");
    name.htmlFor = id;
    name.textContent = parameter.label;
    this.number = this.#input("number", { min: parameter.minimum, max: parameter.maximum, step: "any" });
    this.number.setAttribute("aria-label", `${parameter.label}, number${parameter.unit ? `, ${parameter.unit}` : ""}`);
    this.range = this.#input("range", { id, min: 0, max: STEPS, step: 1 });
    this.unit = document.createElement("span");
    this.unit.className = "unit";
    this.unit.textContent = parameter.unit ?? "";
    const value = document.createElement("span");
    value.className = "value";
    value.append(this.number, this.unit);
    this.fault = document.createElement("p");
    this.fault.className = "fault";
    this.fault.setAttribute("role", "alert");
    this.fault.hidden = true;
    this.element.append(name, value, this.range, this.fault);
    this.range.addEventListener("input", () => this.#later(this.#rounded(this.scale.value(this.range.value / STEPS))));
    this.number.addEventListener("change", () => this.#typed());
    this.#show(this.value);
  }

  #input(type, attributes) {
    return Object.assign(document.createElement("input"), { type, ...attributes });
  }

  enable(on) {
    this.range.disabled = this.number.disabled = !on;
  }

  /** What the server says, unless a change of ours is still under way. */
  follow(value) {
    if (this.#asked !== null || this.#sending) return;
    this.value = value;
    if (document.activeElement !== this.number) this.#show(value);
  }

  /** Ask the server for a value and show it at once. */
  async ask(value) {
    clearTimeout(this.#timer);
    this.#timer = 0;
    this.#asked = null;
    this.#show(value);
    this.#sending++;
    this.element.classList.add("busy");
    try {
      await this.send(value);
      this.value = value;
      this.fault.hidden = true;
    } catch (error) {
      this.fault.textContent = error.message;
      this.fault.hidden = false;
      if (this.#asked === null && this.#sending === 1) this.#show(this.value);
    } finally {
      this.#sending--;
      if (!this.#sending) this.element.classList.remove("busy");
    }
  }

  #typed() {
    const value = this.number.valueAsNumber, { minimum, maximum, unit } = this.parameter;
    if (value >= minimum && value <= maximum) this.ask(value);
    else {
      this.fault.textContent = `${significant(minimum)} to ${significant(maximum)} ${unit ?? ""}`;
      this.fault.hidden = false;
      this.#show(this.value);
    }
  }

  /** While the slider moves, at most one message every SEND_MS. */
  #later(value) {
    this.#asked = value;
    this.#show(value, this.range);
    this.#timer ||= setTimeout(() => this.ask(this.#asked), SEND_MS);
  }

  #rounded(value) {
    return Number(value.toPrecision(3));
  }

  #show(value, source = null) {
    if (source !== this.range) this.range.value = Math.round(STEPS * this.scale.position(value));
    this.number.value = Number.isFinite(value) ? Number(value.toPrecision(4)) : "";
    this.range.setAttribute("aria-valuetext", `${significant(value)} ${this.parameter.unit ?? ""}`.trim());
  }
}

/** Position 0 … 1 to value and back; logarithmic scales that begin at zero have zero at their end. */
export function scaleOf({ minimum, maximum, logarithmic }) {
  const clip = (t) => Math.min(1, Math.max(0, t));
  if (!logarithmic) {
    return { value: (t) => minimum + t * (maximum - minimum), position: (v) => clip((v - minimum) / (maximum - minimum)) };
  }
  const low = minimum > 0 ? minimum : maximum * 10 ** -DECADES_TO_ZERO, ratio = Math.log(maximum / low);
  return {
    value: (t) => (t <= 0 ? minimum : low * Math.exp(t * ratio)),
    position: (v) => (v <= low ? 0 : clip(Math.log(v / low) / ratio)),
  };
}
