// Buttons and shortcuts: each deed once, for pointer and keyboard alike.

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10, 30, 60, 300];
const SAID = { record: "Recording to ", stop_recording: "Recorded in ", saa: "South Atlantic Anomaly at " };
const byId = (id) => document.getElementById(id);

export class Commands {
  constructor(store, connection, views) {
    Object.assign(this, { store, connection, views });
    for (const speed of SPEEDS) byId("speed").add(new Option(`${speed} ×`, speed));
    byId("speed").value = 1;
    byId("speed").addEventListener("change", (event) => this.#send("speed", { factor: Number(event.target.value) }));
    byId("source").addEventListener("change", (event) => this.#send("source", { attitude: event.target.value }));
    for (const name of ["pause", "step", "record", "blind", "saa", "kick"]) byId(name).addEventListener("click", () => this[name]());
    byId("help").addEventListener("click", () => this.help());
    store.addEventListener("state", () => this.#follow(store.state));
    store.addEventListener("welcome", () => this.#offer(store.welcome.commands ?? []));
    store.addEventListener("link", () => this.#enable(store.link.state === "open"));
    this.keys = this.#table();
    this.#list();
    document.addEventListener("keydown", (event) => this.#key(event));
  }

  pause() {
    return this.#send(this.store.state?.paused ? "resume" : "pause");
  }

  /** One frame; a running mission is paused first. */
  async step() {
    if (!this.store.state?.paused) await this.#send("pause");
    return this.#send("step");
  }

  record() {
    return this.#send(this.store.state?.recording ? "stop_recording" : "record");
  }

  blind() {
    return this.#send(this.store.state?.blinded ? "unblind" : "blind");
  }

  saa() {
    return this.#send("saa");
  }

  kick() {
    const rate = [0, 0, 0], size = byId("kick-rate").valueAsNumber;
    if (!Number.isFinite(size)) return this.#notice("the rate of a kick is a number of degrees per second");
    rate[Number(byId("kick-axis").value)] = size;
    return this.#send("kick", { rate_deg_s: rate });
  }

  faster(by) {
    const select = byId("speed"), index = select.selectedIndex + by;
    if (index < 0 || index >= select.options.length) return;
    select.selectedIndex = index;
    this.#send("speed", { factor: Number(select.value) });
  }

  help() {
    byId("shortcuts").showModal();
  }

  async #send(name, values = {}) {
    try {
      const { detail } = await this.connection.command(name, values);
      this.#notice(detail ? (SAID[name] ?? "") + detail : "");
    } catch (error) {
      this.#notice(error.message);
    }
  }

  #notice(text) {
    byId("notice").textContent = text;
    byId("notice").hidden = !text;
  }

  #follow(state) {
    if (state.notice && state.notice !== this.told) this.#notice(state.notice);
    this.told = state.notice;
    byId("pause-text").textContent = state.paused ? "Resume" : "Pause";
    document.querySelector("#pause .glyph").textContent = state.paused ? "▶" : "❚❚";
    const recording = Boolean(state.recording);
    byId("record").setAttribute("aria-pressed", recording);
    byId("record-text").textContent = recording ? "Stop" : "Record";
    document.querySelector("#record .dot").classList.toggle("on", recording);
    byId("blind").setAttribute("aria-pressed", Boolean(state.blinded));
    byId("blind").textContent = state.blinded ? "Unblind" : "Blind";
    if (document.activeElement !== byId("source") && state.source) byId("source").value = state.source;
    if (document.activeElement !== byId("speed")) this.#showSpeed(state.speed);
  }

  #showSpeed(speed) {
    const select = byId("speed");
    if (!Number.isFinite(speed)) return;
    if (![...select.options].some((option) => Number(option.value) === speed)) {
      const next = [...select.options].find((option) => Number(option.value) > speed) ?? null;
      select.add(new Option(`${speed} ×`, speed), next);
    }
    select.value = speed;
  }

  /** Only what the server can do. */
  #offer(names) {
    if (!names.length) return;
    for (const name of ["step", "saa", "kick", "record", "blind"]) byId(name).hidden = !names.includes(name);
  }

  #enable(on) {
    for (const id of ["pause", "step", "speed", "record", "blind", "saa", "kick", "source"]) byId(id).disabled = !on;
  }

  #table() {
    const { frame, chart, theme } = this.views;
    return [
      [[" "], "Space", "pause or resume", () => this.pause()],
      [["n"], "N", "one step", () => this.step()],
      [[","], ",", "slower", () => this.faster(-1)],
      [["."], ".", "faster", () => this.faster(1)],
      [["r"], "R", "record, or stop recording", () => this.record()],
      [["b"], "B", "blind or unblind the camera", () => this.blind()],
      [["k"], "K", "kick", () => this.kick()],
      [["a"], "A", "next South Atlantic Anomaly", () => this.saa()],
      [["i"], "I", "identified stars on or off", () => frame.toggle("stars")],
      [["l"], "L", "names on or off", () => frame.toggle("names")],
      [["d"], "D", "detections on or off", () => frame.toggle("detections")],
      [["g"], "G", "grid on or off", () => frame.toggle("grid")],
      [["h"], "H", "hold the brightness scale", () => frame.toggleHold()],
      [["z"], "Z", "zoom about the cursor", () => frame.zoom()],
      [["c"], "C", "errors linear or logarithmic", () => chart.toggleLog()],
      [["t"], "T", "theme: auto, light, dark", () => theme.next()],
      [["?"], "?", "this list", () => this.help()],
    ];
  }

  #list() {
    const rows = [...this.keys.map(([, key, text]) => [key, text]), ["Arrows", "in the frame: read another pixel (Shift: by one); in the sky: turn the map"]];
    for (const [key, text] of rows) {
      const row = byId("shortcut-rows").insertRow(), head = document.createElement("th"), kbd = document.createElement("kbd");
      kbd.textContent = key;
      head.scope = "row";
      head.append(kbd);
      row.append(head);
      row.insertCell().textContent = text;
    }
  }

  #key(event) {
    const target = event.target, typing = target.matches("input[type=number], select, textarea");
    const pressing = event.key === " " && target.matches("button, input, a");
    if (typing || pressing || event.ctrlKey || event.metaKey || event.altKey) return;
    if (byId("shortcuts").open || (!byId("shortcuts-on").checked && event.key !== "?")) return;
    const entry = this.keys.find(([keys]) => keys.includes(event.key.toLowerCase()));
    if (!entry) return;
    event.preventDefault();
    entry[3]();
  }
}
