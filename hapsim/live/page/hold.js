// @ts-check
/** The hand that holds a mock: a spring that pulls its channels to where a picture drags them. */

export class Hold {
  /** @param {(values: Record<string, any> | null) => void} set sends new values; null gives back what was held */
  constructor(set) {
    this.set = set;
    /** @type {any} */
    this.model = null;
    /** @type {number[]} */
    this.channels = []; // that are dragged,
    /** @type {number[] | null} */
    this.to = null; // and where to, m or rad; null: nothing is
    this.isSent = true;
  }

  /** @param {any} model */
  describe(model) {
    this.model = model;
  }

  /** Lets a canvas drag. @param {HTMLCanvasElement} canvas @param {(event: PointerEvent) => void} drag takes the events of a pointer while it is down @param {(way: number) => void} push takes an arrow key, 1 up or right */
  attach(canvas, drag, push) {
    canvas.onpointerdown = canvas.onpointermove = (event) => {
      if (!this.model?.has_mock) return;
      if (event.type === "pointerdown") canvas.setPointerCapture(event.pointerId);
      if (canvas.hasPointerCapture(event.pointerId)) drag(event);
    };
    canvas.onpointerup = canvas.onpointercancel = canvas.onkeyup = canvas.onblur = () => this.release();
    canvas.onkeydown = (event) => {
      const way = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
      if (!way || !this.model?.has_mock) return;
      event.preventDefault();
      push(way);
    };
  }

  /** Where it drags this channel to; null where it does not. @param {number} channel @returns {number | null} */
  target(channel) {
    return this.to?.[this.channels.indexOf(channel)] ?? null;
  }

  /** Drags these channels to these places; they go with the next `send`. @param {number[]} channels @param {number[]} to */
  drag(channels, to) {
    [this.channels, this.to, this.isSent] = [channels, to, false];
  }

  release() {
    if (this.to === null) return;
    this.to = null;
    this.set(null);
  }

  /** Sends the newest places, once a frame. */
  send() {
    if (this.isSent || this.to === null) return;
    this.isSent = true;
    const each = (/** @type {(hand: any, at: number) => number} */ value) => {
      const values = this.model.channels.map((/** @type {any} */ one, /** @type {number} */ c) => (this.channels.includes(c) ? value(one.hand, this.channels.indexOf(c)) : 0));
      return values.length > 1 ? values : values[0];
    };
    this.set({ "mock.hand.stiffness": each((hand) => hand.stiffness), "mock.hand.damping": each((hand) => hand.damping), "mock.hand.position": each((_, at) => this.to?.[at] ?? 0) });
  }
}
