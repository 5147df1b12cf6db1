// The WebSocket: hello, subscription, requests with their replies, frames with their bytes, and reconnection with back-off.

const FIRST_WAIT_MS = 500, LONGEST_WAIT_MS = 15000, REPLY_MS = 20000;

export class Connection extends EventTarget {
  #socket = null;
  #header = null;
  #pending = new Map();
  #next = 1;
  #wait = FIRST_WAIT_MS;
  #timer = 0;

  constructor(url) {
    super();
    this.url = url;
    document.addEventListener("visibilitychange", () => this.subscribe());
  }

  get open() {
    return this.#socket?.readyState === WebSocket.OPEN;
  }

  start() {
    clearTimeout(this.#timer);
    this.#tell("link", { state: "connecting" });
    const socket = new WebSocket(this.url);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => this.#greet();
    socket.onmessage = (event) => this.#receive(event.data);
    socket.onclose = (event) => this.#lost(event);
    this.#socket = socket;
  }

  /** Try again now instead of after the wait. */
  retry() {
    if (this.#socket?.readyState === WebSocket.CLOSED) this.start();
  }

  /** Frames only while someone looks: a hidden tab gets the small messages alone. */
  subscribe() {
    if (!this.open) return;
    const channels = document.hidden ? ["solution", "truth", "state"] : ["frame", "solution", "truth", "state"];
    this.#send({ type: "subscribe", channels, frame_format: document.hidden ? "none" : "raw16", every: 1 });
  }

  /** Send a message; resolves with the reply, rejects with an Error that has the server's reason. */
  request(message) {
    if (!this.open) return Promise.reject(new Error("not connected"));
    const id = this.#next++;
    return new Promise((resolve, reject) => {
      const timer = setTimeout(() => this.#settle(id, { ok: false, reason: "no reply from the server" }), REPLY_MS);
      this.#pending.set(id, { resolve, reject, timer });
      this.#send({ ...message, id });
    });
  }

  command(name, values = {}) {
    return this.request({ type: "command", name, ...values });
  }

  #greet() {
    const token = new URLSearchParams(location.search).get("token");
    this.#send({ type: "hello", protocol: 1, ...(token ? { token } : {}) });
    this.subscribe();
  }

  #send(message) {
    this.#socket.send(JSON.stringify(message));
  }

  #receive(data) {
    if (typeof data !== "string") {
      if (this.#header) this.#tell(this.#header.type, { ...this.#header, data });
      this.#header = null;
      return;
    }
    const message = JSON.parse(data);
    if (message.type === "frame" || message.type === "stimulus") this.#header = message;
    else if (message.type === "reply") this.#settle(message.id, message);
    else if (message.type === "error") this.#settle(message.id, { ...message, ok: false });
    else {
      if (message.type === "welcome") {
        this.#wait = FIRST_WAIT_MS;
        this.#tell("link", { state: "open" });
      }
      this.#tell(message.type, message);
    }
  }

  #settle(id, reply) {
    const entry = this.#pending.get(id);
    if (!entry) {
      if (!reply.ok) this.#tell("fault", reply);
      return;
    }
    this.#pending.delete(id);
    clearTimeout(entry.timer);
    if (reply.ok) entry.resolve(reply);
    else entry.reject(new Error(reply.reason ?? "refused"));
  }

  #lost(event) {
    this.#header = null;
    for (const id of [...this.#pending.keys()]) this.#settle(id, { ok: false, reason: "connection lost" });
    const wait = this.#wait;
    this.#wait = Math.min(2 * wait, LONGEST_WAIT_MS);
    this.#tell("link", { state: "lost", wait_s: wait / 1000, reason: event.reason });
    this.#timer = setTimeout(() => this.start(), wait);
  }

  #tell(type, detail) {
    this.dispatchEvent(new CustomEvent(type, { detail }));
  }
}
