// @ts-check
/** The page of a running scene. */

import { Connection } from "./connection.js";
import { makeControls } from "./controls.js";
import { Plane } from "./plane.js";
import { Scope, line, prepared, short } from "./scope.js";

const HAND = { "mock.hand.stiffness": 200, "mock.hand.damping": 2 };
const MOST_EVENTS = 200;

/** @param {string} id @returns {any} */
const part = (id) => document.getElementById(id);
const connection = new Connection();
export const scope = new Scope(part("scope"));
const plane = new Plane(part("plane"), part("felt"), part("note"));
/** @type {any} */
let model = null;
/** @type {(values: Record<string, any>) => void} */
let showValues = () => {};
/** @type {{values: any, isApplied: boolean} | null} */
let wanted = null; // the newest prediction to ask for
let isAsking = false;
let isRecording = false;
/** @type {any} */
let counters = null;

connection.addEventListener("open", begin);
connection.addEventListener("closed", () => status("not connected: the run has ended, or hapsim cannot be reached", true));
connection.addEventListener("samples", (event) => scope.add(/** @type {CustomEvent} */ (event).detail));
connection.addEventListener("counters", (event) => (counters = /** @type {CustomEvent} */ (event).detail.progress));
connection.addEventListener("event", (event) => hear(/** @type {CustomEvent} */ (event).detail));

async function begin() {
  await describe();
  scope.clear();
  await connection.ask({ type: "subscribe", rate: 60, history: 60 });
}

async function describe() {
  model = await connection.ask({ type: "get" });
  document.title = `${model.title} · hapsim`;
  part("title").textContent = model.title;
  plane.isRotary = model.channels[0]?.motion === "rotary";
  const choices = model.channels.flatMap((/** @type {any} */ one) =>
    ["position", "velocity", "force"].map((name, quantity) => {
      const unit = [one.unit_position, `${one.unit_position}/s`, one.unit_force][quantity];
      return new Option(model.channels.length > 1 ? `${name} of ${one.name}` : name, `${quantity} ${one.channel} ${unit}`);
    }),
  );
  const chosen = part("what").selectedIndex;
  part("what").replaceChildren(...choices);
  part("what").selectedIndex = Math.max(0, Math.min(chosen, choices.length - 1));
  choose();
  showValues = makeControls(part("parameters"), model.parameters, (values) => predict(values, false), apply);
  part("record").hidden = !model.can_record;
  recording(Boolean(model.recording));
  part("hand-part").hidden = !model.has_mock;
  part("events").replaceChildren();
  model.events.forEach(list);
  predict({}, true);
}

function choose() {
  const [quantity, channel, unit] = part("what").value.split(" ");
  Object.assign(scope, { quantity: Number(quantity), channel: Number(channel), unit });
}

/** Asks what the hand would feel; while an answer is awaited, the newest question waits. @param {any} values @param {boolean} isApplied */
async function predict(values, isApplied) {
  wanted = { values, isApplied };
  if (isAsking) return;
  isAsking = true;
  try {
    while (wanted) {
      const asked = wanted;
      wanted = null;
      const answer = await connection.ask({ type: "predict", values: asked.values, plane: true });
      if (answer.type === "predicted") plane.show(answer, asked.isApplied);
      else status(answer.reason, true);
    }
  } finally {
    isAsking = false;
  }
}

/** @param {Record<string, any>} values */
async function apply(values) {
  const answer = await connection.ask({ type: "set", values });
  if (answer.type === "rejected") {
    list({ kind: "rejected", sentence: answer.reason, at: new Date().toISOString() });
    model && describe();
  }
}

/** @param {any} event */
function hear(event) {
  if (event.kind === "changed" && Object.keys(event.values).length) {
    showValues(event.values);
    if (!Object.keys(event.values).every((name) => name.startsWith("mock."))) predict({}, true);
    return;
  }
  if (event.kind === "changed" || event.kind === "armed") begin();
  if (event.kind === "recording" || event.kind === "recorded") recording(event.kind === "recording");
  if (event.kind !== "rejected") list(event);
}

/** @param {any} event */
function list(event) {
  const item = document.createElement("li"), kind = document.createElement("span");
  kind.className = ["lost", "guard", "rejected"].includes(event.kind) ? "kind bad" : "kind";
  kind.textContent = event.kind;
  const values = Object.entries(event.values ?? {}).map(([name, value]) => `${name} ${short(value)}`);
  item.append(kind, ` ${event.at.slice(11, 19)} ${event.sentence || values.join(", ")}`);
  part("events").prepend(item);
  while (part("events").children.length > MOST_EVENTS) part("events").lastChild.remove();
}

/** @param {boolean} isOn */
function recording(isOn) {
  isRecording = isOn;
  part("record").textContent = isOn ? "End the record" : "Record";
  part("record").setAttribute("aria-pressed", String(isOn));
}

/** @param {string} text @param {boolean} [isBad] */
function status(text, isBad = false) {
  part("status").textContent = text;
  part("status").classList.toggle("bad", isBad);
}

part("what").onchange = choose;
part("span").onchange = () => (scope.spanS = Number(part("span").value));
part("freeze").onclick = () => {
  scope.isFrozen = !scope.isFrozen;
  part("freeze").setAttribute("aria-pressed", String(scope.isFrozen));
  if (!scope.isFrozen) begin();
};
part("marker").onclick = () => connection.ask({ type: "marker", text: "from the page" });
part("stop").onclick = () => connection.ask({ type: "stop" });
part("record").onclick = async () => {
  const answer = await connection.ask({ type: "record", on: !isRecording });
  if (answer.type === "rejected") status(answer.reason, true);
};
addEventListener("keydown", (event) => {
  const isTyping = event.target instanceof HTMLInputElement && event.target.type === "number";
  if (event.code === "Space") {
    event.preventDefault(); // it stops the force, whatever has the focus
    part("stop").click();
  } else if (!isTyping && event.key === "f") part("freeze").click();
  else if (!isTyping && event.key === "m") part("marker").click();
});

// The hand that holds the mock

/** @type {HTMLCanvasElement} */
const handle = part("handle");
let reach = 0.02;
/** @type {number | null} */
let dragged = null;
let isSent = true;

/** @param {PointerEvent} event */
function drag(event) {
  if (event.type === "pointerdown") handle.setPointerCapture(event.pointerId);
  else if (dragged === null) return;
  const box = handle.getBoundingClientRect();
  dragged = (2 * ((event.clientX - box.left) / box.width) - 1) * reach;
  isSent = false;
}

function release() {
  if (dragged === null) return;
  dragged = null;
  connection.ask({ type: "set", values: { "mock.hand.stiffness": 0, "mock.hand.damping": 0 } });
}

handle.onpointerdown = handle.onpointermove = drag;
handle.onpointerup = handle.onpointercancel = release;

function drawHandle() {
  const { context, width, height, look } = prepared(handle);
  const position = scope.count ? scope.columns[0][(scope.count - 1) % scope.size] : 0;
  reach = Math.max(reach, Math.abs(position) * 1.1);
  const x = (/** @type {number} */ at) => width / 2 + (at / reach) * (width / 2 - 20), y = height / 2;
  context.strokeStyle = look.line;
  line(context, 10, y, width - 10, y);
  line(context, x(0), y - 14, x(0), y + 14);
  if (dragged !== null) {
    context.strokeStyle = look.warm;
    context.lineWidth = 2;
    line(context, x(position), y, x(dragged), y);
  }
  context.fillStyle = look.accent;
  context.beginPath();
  context.roundRect(x(position) - 9, y - 24, 18, 48, 5);
  context.fill();
}

function frame() {
  if (model) {
    if (!isSent && dragged !== null) {
      const value = model.channels.length > 1 ? model.channels.map((/** @type {any} */ _, /** @type {number} */ c) => (c ? 0 : dragged)) : dragged;
      connection.ask({ type: "set", values: { ...HAND, "mock.hand.position": value } });
      isSent = true;
    }
    scope.draw(model.channels.length);
    plane.draw();
    if (model.has_mock) drawHandle();
    if (counters && connection.socket?.readyState === WebSocket.OPEN) {
      const { phase, elapsed_s, rate_hz, deadline_misses, ticks: all } = counters;
      status(`${phase} ${elapsed_s.toFixed(0)} s at ${rate_hz.toFixed(1)} Hz, ${deadline_misses} of ${all} samples late`);
    }
  }
  requestAnimationFrame(frame);
}
frame();
