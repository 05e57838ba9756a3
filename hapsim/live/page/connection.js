// @ts-check
/** The WebSocket to a running hapsim: requests with answers, events, blocks of samples. */

/** @typedef {{first: number, period: number, rows: number, columns: number, channels: number, values: Float32Array}} Block */

export class Connection extends EventTarget {
  constructor() {
    super();
    /** @type {Map<number, (answer: any) => void>} */
    this.waiting = new Map();
    this.last = 0;
    this.open();
  }

  open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    this.socket = new WebSocket(`${scheme}://${location.host}/live`);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => this.dispatchEvent(new Event("open"));
    this.socket.onclose = (event) => {
      const lost = [...this.waiting.values()];
      this.waiting.clear();
      lost.forEach((answer) => answer({ type: "rejected", reason: "the connection was lost before hapsim answered" }));
      this.dispatchEvent(new CustomEvent("closed", { detail: event.reason }));
      setTimeout(() => this.open(), 2000);
    };
    this.socket.onmessage = (event) => (typeof event.data === "string" ? this.receive(JSON.parse(event.data)) : this.take(event.data));
  }

  /** Sends a request. @param {object} request @returns {Promise<any>} its answer: one that rejects it where nobody answers */
  ask(request) {
    const id = ++this.last;
    return new Promise((resolve) => {
      if (this.socket?.readyState !== WebSocket.OPEN) return resolve({ type: "rejected", reason: "not connected to hapsim" });
      this.waiting.set(id, resolve);
      this.socket.send(JSON.stringify({ ...request, id }));
    });
  }

  /** @param {any} message */
  receive(message) {
    const answered = this.waiting.get(message.id);
    this.waiting.delete(message.id);
    if (answered) answered(message);
    else this.dispatchEvent(new CustomEvent(message.type, { detail: message }));
  }

  /** @param {ArrayBuffer} data */
  take(data) {
    const head = new DataView(data);
    const kind = ["samples", "modules", "picture"][head.getUint32(0, true) - 1];
    /** @type {Block} */
    const block = {
      rows: head.getUint32(4, true),
      columns: head.getUint32(8, true),
      channels: head.getUint32(12, true),
      first: head.getFloat64(16, true),
      period: head.getFloat64(24, true),
      values: new Float32Array(data, 32),
    };
    this.dispatchEvent(new CustomEvent(kind, { detail: block }));
  }
}
