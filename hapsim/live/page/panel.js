// @ts-check
/** The page of a running scene. */

import { Connection } from "./connection.js";
import { makeControls, refuseAt } from "./controls.js";
import { line, prepared, short, shownIn } from "./drawing.js";
import { drawHistogram } from "./histogram.js";
import { Plane } from "./plane.js";
import { Samples } from "./samples.js";
import { Scope } from "./scope.js";
import { coordinatesOf, drawTable, handsOf, placesOf, viewOf } from "./table.js";

const MOST_EVENTS = 200, MOST_WATCHED = 64; // as messages.py has it

/** @param {string} id @returns {any} */
const part = (id) => document.getElementById(id);
export const connection = new Connection();
export const samples = new Samples();
export const scope = new Scope(part("scope"), samples, showScope);
/** @type {HTMLCanvasElement} */
const handle = part("handle");
const plane = new Plane(part("plane"), part("felt"), part("note"));
/** @type {any} */
let model = null;
let reach = 0;
/** @type {ReturnType<typeof makeControls> | null} */
let controls = null;
/** @type {{values: any, isApplied: boolean} | null} */
let wanted = null; // the newest prediction to ask for
let asked = { values: {}, isApplied: true }; // the last one,
let askedAt = 0; // when, ms,
/** @type {number[]} */
let askedFrom = []; // and where the hands were
const MOVED = 1e-4; // m or rad, by which a hand may meet another contact
let isAsking = false;
let isRecording = false;
let watched = ""; // the module on the scope
/** @type {any} */
let counters = null;
/** @type {Record<string, string>} */
let words = {}; // by counter: what follows its count

connection.addEventListener("open", begin);
connection.addEventListener("closed", () => status("not connected: the run has ended, or hapsim cannot be reached", true));
connection.addEventListener("samples", (event) => samples.add(/** @type {CustomEvent} */ (event).detail));
connection.addEventListener("modules", (event) => samples.addModules(/** @type {CustomEvent} */ (event).detail));
connection.addEventListener("counters", (event) => count(/** @type {CustomEvent} */ (event).detail));
connection.addEventListener("event", (event) => receive(/** @type {CustomEvent} */ (event).detail));

async function begin() {
  words = await (await fetch("counters.json")).json();
  await describe();
  samples.clear();
  await subscribe(60);
}

/** @param {number} history seconds of samples that come first */
async function subscribe(history) {
  samples.watch();
  const others = model.space > 1 ? coordinatesOf(model).slice(0, MOST_WATCHED - 1) : [];
  const modules = samples.watched = watched ? [watched, ...others] : others;
  await demand("scope-part", { type: "subscribe", rate: 60, history, modules });
}

/** Asks for something, and says in the part of the page that did so why it was refused.
 * @param {string} from its id, or its tag @param {object} request @returns {Promise<any>} */
async function demand(from, request) {
  const place = /** @type {HTMLElement} */ (document.getElementById(from) ?? document.querySelector(from));
  const answer = await connection.ask(request);
  refuseAt(place, answer.type === "rejected" ? `Refused: ${answer.reason}` : "");
  return answer;
}

async function describe() {
  const answer = await connection.ask({ type: "get" });
  if (answer.type === "rejected") return; // the connection is gone, and will ask again
  model = answer;
  document.title = `${model.title} · hapsim`;
  part("title").textContent = model.title;
  offer();
  const parameters = model.parameters.map((/** @type {any} */ one) => ({ ...one, shown: shownIn(one.unit, model.written) }));
  controls = makeControls(part("parameters"), parameters, (values) => predict(values, false), apply);
  part("record").hidden = !model.can_record;
  recording(Boolean(model.recording));
  part("hand-part").hidden = !model.has_mock;
  const { hand, unit_force, unit_position } = model.channels[0];
  const [unit, factor] = shownIn(`${unit_force}/${unit_position}`, model.written);
  reach = Math.max(reach, hand.reach);
  view = null;
  handle.classList.toggle("square", model.space > 1);
  part("hand-note").textContent = `Drag: a spring of ${Number((hand.stiffness * factor).toPrecision(3))} ${unit} pulls the handle along.`;
  part("events").replaceChildren();
  model.events.forEach(list);
  predict({}, true);
}

/** Fills the list of what the scope can show. */
function offer() {
  const channels = model.channels.flatMap((/** @type {any} */ one) =>
    ["position", "velocity", "force", ...model.sensed.map((/** @type {string} */ name) => `sensed ${name}`)].map(
      (name, quantity) => new Option(model.channels.length > 1 ? `${name} of ${one.name}` : name, `${quantity} ${one.channel}`),
    ),
  );
  const hands = model.channels.map((/** @type {any} */ one) => one.name);
  const modules = model.modules
    .filter((/** @type {any} */ one) => !hands.includes(one.name))
    .map((/** @type {any} */ one) => new Option(one.masses === null ? one.name : `${one.name}, a mass of it`, `module ${one.name}`));
  const chosen = part("what").value;
  part("what").replaceChildren(...channels, ...modules);
  part("what").value = [...channels, ...modules].some((one) => one.value === chosen) ? chosen : channels[0]?.value;
  choose(false);
}

/** Sets the unit of the scope. @param {any} channel @param {number} quantity */
function show({ unit_position: position, unit_force }, quantity) {
  const sensed = model.sensed.map((/** @type {string} */ name) => `${position}/s${name === "acceleration" ? "²" : ""}`);
  const units = [position, `${position}/s`, unit_force, ...sensed];
  [scope.unit, scope.factor] = shownIn(units[quantity] ?? position, model.written);
  scope.trigger.level = Number(part("level").value) / scope.factor;
}

/** @param {boolean} [asks] whether what is watched may change */
async function choose(asks = true) {
  const [quantity, channel] = part("what").value.split(" ");
  const module = quantity === "module" ? model.modules.find((/** @type {any} */ one) => one.name === channel) : null;
  part("place").hidden = !module || module.masses === null;
  if (!module) {
    scope.what = { quantity: Number(quantity), channel: Number(channel) };
    show(model.channels[Number(channel)], Number(quantity));
    return;
  }
  const middle = module.columns ? `${Math.floor(module.masses / module.columns / 2)}.${Math.floor(module.columns / 2)}` : String(Math.floor(module.masses / 2));
  if (part("place").dataset.of !== channel) [part("place").value, part("place").dataset.of] = [middle, channel];
  const name = module.masses === null ? channel : `${channel}.${part("place").value}`;
  scope.what = null;
  show(model.channels[0], 0);
  if (name === watched) return;
  watched = name;
  if (asks) await subscribe(0);
}

/** @param {any} message */
function count(message) {
  counters = message.progress;
  drawHistogram(part("exchange"), "Exchange of position and force", message.exchange);
  drawHistogram(part("lateness"), "Lateness", message.lateness);
}

/** What was counted beside late samples. @param {Record<string, number>} counts */
const noted = (counts) => Object.entries(words).map(([name, text]) => (counts[name] ? `, ${counts[name]} ${text}` : "")).join("");

function showScope() {
  part("freeze").setAttribute("aria-pressed", String(scope.isFrozen));
  const { mode, isRising } = scope.trigger;
  part("freeze").textContent = scope.isFrozen ? (mode === "single" ? "Next trigger" : "Resume") : "Freeze";
  part("trigger-how").hidden = mode === "off";
  part("slope").textContent = isRising ? "↗" : "↘";
  const spans = [...part("span").options].map((one) => Number(one.value));
  part("span").selectedIndex = spans.indexOf(scope.spanS); // none where it is zoomed
}

/** Asks what the hand would feel; while an answer is awaited, the newest question waits. @param {any} values @param {boolean} isApplied */
async function predict(values, isApplied) {
  wanted = { values, isApplied };
  if (isAsking) return;
  isAsking = true;
  try {
    while (wanted) {
      [asked, wanted] = [wanted, null];
      const at = samples.count ? places() : [];
      [askedAt, askedFrom] = [performance.now(), at];
      const answer = await connection.ask({ type: "predict", values: asked.values, at, hand: plane.hand, plane: true });
      if (answer.type === "predicted") {
        feel(answer, asked.isApplied);
        refuseAt(part("plane-part"), "");
      } else if (!controls?.refuse(asked.values, answer.reason, false)) refuseAt(part("plane-part"), `Not predicted: ${answer.reason}`);
    }
  } finally {
    isAsking = false;
  }
}

/** The newest position of a channel. @param {number} channel */
const latest = (channel) => (samples.count ? samples.columns[channel][(samples.count - 1) % samples.size] : 0);

/** Where a hand is, within its travel. @param {number} channel */
function place(channel) {
  const [low, high] = model.channels[channel]?.travel ?? [null, null];
  const x = latest(channel);
  return Math.min(Math.max(x, low ?? -Infinity), high ?? Infinity);
}

/** @returns {number[]} */
const places = () => model.channels.map((/** @type {any} */ _, /** @type {number} */ channel) => place(channel));

/** Asks anew where the hand has left the region that is shown, or has moved while it may touch masses, at most five times
 * a second: faster figures are not read. */
function follow() {
  const region = plane.applied?.hands?.[plane.hand]?.region;
  const moves = plane.applied?.contacts || model.space > 1; // what it touches
  if (!(region || moves) || isAsking || performance.now() < askedAt + 200) return;
  const x = place(plane.channel), low = region?.low_m ?? -Infinity, high = region?.high_m ?? Infinity;
  const isAway = moves && places().some((at, i) => Math.abs(at - (askedFrom[i] ?? 0)) > MOVED);
  if (x < low || x > high || isAway) predict(asked.values, asked.isApplied);
}

/** @param {any} predicted @param {boolean} isApplied */
function feel(predicted, isApplied) {
  const names = predicted.hands.map((/** @type {any} */ one) => one.name), shown = [...part("hand").options].map((one) => one.value);
  if (names.join() !== shown.join()) {
    part("hand").replaceChildren(...names.map((/** @type {string} */ name) => new Option(name)));
    part("hand-row").hidden = names.length < 2;
    plane.hand = Math.min(plane.hand, Math.max(0, names.length - 1));
    part("hand").selectedIndex = plane.hand;
  }
  plane.channel = predicted.hands[plane.hand]?.channel ?? 0;
  plane.turns(model.channels[plane.channel]?.motion === "rotary", model.written);
  plane.show(predicted, isApplied);
}

/** @param {Record<string, any>} values */
async function apply(values) {
  const answer = await connection.ask({ type: "set", values });
  if (answer.type === "rejected") {
    list({ kind: "rejected", sentence: answer.reason, at: new Date().toISOString() });
    controls?.refuse(values, answer.reason);
    predict({}, true);
  }
}

/** @param {any} event */
function receive(event) {
  if (event.kind === "changed" && Object.keys(event.values).length) {
    controls?.show(event.values);
    if (!Object.keys(event.values).every((name) => name.startsWith("mock."))) predict({}, true);
    return;
  }
  if (event.kind === "place") return; // of a detent: there may be a hundred a second
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

part("what").onchange = part("place").onchange = () => choose();
part("span").onchange = () => (scope.spanS = Number(part("span").value));
part("freeze").onclick = () => scope.freeze(!scope.isFrozen);
part("trigger").onchange = () => {
  scope.trigger.mode = part("trigger").value;
  scope.freeze(false);
};
part("slope").onclick = () => {
  scope.trigger.isRising = !scope.trigger.isRising;
  scope.freeze(false);
};
part("level").oninput = () => {
  scope.trigger.level = Number(part("level").value) / scope.factor;
  scope.freeze(false);
};
part("hand").onchange = () => {
  plane.hand = part("hand").selectedIndex;
  predict({}, true);
};
part("marker").onclick = () => demand("header", { type: "marker", text: "from the page" });
part("stop").onclick = () => demand("header", { type: "stop" });
part("record").onclick = () => demand("header", { type: "record", on: !isRecording });
addEventListener("keydown", (event) => {
  const isTyping = event.target instanceof HTMLInputElement && event.target.type !== "range";
  if (event.code === "Space" || event.key === " ") { // a phone's keyboard has no codes
    event.preventDefault(); // it stops the force, whatever has the focus
    part("stop").click();
  } else if (!isTyping && event.key === "f") part("freeze").click();
  else if (!isTyping && event.key === "m") part("marker").click();
});

// The hand that holds the mock

/** @type {import("./table.js").View | null} */
let view = null; // of the plane
let held = 0; // the hand that is dragged: of the plane
/** @type {number[] | null} */
let dragged = null; // where to: one number, or x and y
let isSent = true;

/** Where every point of the plane is. */
const points = () => placesOf(new Map([...model.channels.map((/** @type {any} */ one) => [one.name, latest(one.channel)]), ...samples.latest]));

/** @param {PointerEvent} event */
function drag(event) {
  const { left, top, width, height } = handle.getBoundingClientRect(), isPlane = model?.space > 1;
  if (isPlane && !view) return;
  const along = (2 * (event.clientX - left)) / width - 1, up = 1 - (2 * (event.clientY - top)) / height;
  const to = isPlane && view ? [view.x + along * view.half * (width / Math.min(width, height)), view.y + up * view.half * (height / Math.min(width, height))] : [along * reach];
  if (event.type === "pointerdown") {
    handle.setPointerCapture(event.pointerId);
    const away = handsOf(model).map((channels) => Math.hypot(...channels.map((one, axis) => latest(one) - to[axis])));
    held = Math.max(0, away.indexOf(Math.min(...away)));
  } else if (dragged === null) return;
  dragged = to;
  isSent = false;
}

function release() {
  if (dragged === null) return;
  dragged = null;
  demand("hand-part", { type: "set", values: { "mock.hand.stiffness": 0, "mock.hand.damping": 0 } });
}

handle.onpointerdown = handle.onpointermove = drag;
handle.onpointerup = handle.onpointercancel = release;
handle.onkeydown = (event) => {
  const [axis, way] = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowDown: [1, -1], ArrowUp: [1, 1] }[event.key] ?? [2, 0];
  if (axis >= model?.space || !way) return;
  event.preventDefault();
  const farthest = view?.half ?? reach, middle = view ? [view.x, view.y] : [0];
  dragged = [...(dragged ?? (view ? handsOf(model)[held].map(latest) : [0]))];
  dragged[axis] = middle[axis] + Math.max(-farthest, Math.min(farthest, dragged[axis] - middle[axis] + 0.05 * way * farthest));
  isSent = false;
};
handle.onkeyup = handle.onblur = release;

/** The values with which the hand pulls to where it is dragged. */
function pull() {
  const { hand } = model.channels[0], channels = model.space > 1 ? handsOf(model)[held] : [0];
  const each = (/** @type {(axis: number) => number} */ value) => {
    const values = model.channels.map((/** @type {any} */ _, /** @type {number} */ c) => (channels.includes(c) ? value(channels.indexOf(c)) : 0));
    return values.length > 1 ? values : values[0];
  };
  return { "mock.hand.stiffness": each(() => hand.stiffness), "mock.hand.damping": each(() => hand.damping), "mock.hand.position": each((axis) => dragged?.[axis] ?? 0) };
}

function drawPlane() {
  const places = points(), channels = handsOf(model)[held];
  view = viewOf(model, places, view);
  const from = /** @type {[number, number]} */ (channels.map(latest));
  drawTable(prepared(handle), model, places, view, dragged && { from, to: [dragged[0], dragged[1]] });
  if (!model.outlines.every((/** @type {any} */ one) => !one.about || places.has(one.about))) view = null; // more is to come
}

function drawHandle() {
  const { context, width, height, look } = prepared(handle);
  const position = latest(0);
  reach = Math.max(reach, Math.abs(position) * 1.1);
  const x = (/** @type {number} */ at) => width / 2 + (at / reach) * (width / 2 - 20), y = height / 2;
  context.strokeStyle = look.line;
  line(context, 10, y, width - 10, y);
  line(context, x(0), y - 14, x(0), y + 14);
  if (dragged !== null) {
    context.strokeStyle = look.warm;
    context.lineWidth = 2;
    line(context, x(position), y, x(dragged[0]), y);
  }
  context.fillStyle = look.accent;
  context.beginPath();
  context.roundRect(x(position) - 9, y - 24, 18, 48, 5);
  context.fill();
}

function frame() {
  if (model) {
    if (!isSent && dragged !== null) {
      demand("hand-part", { type: "set", values: pull() });
      isSent = true;
    }
    scope.draw();
    follow();
    plane.draw();
    if (model.has_mock) model.space > 1 ? drawPlane() : drawHandle();
    if (counters && connection.socket?.readyState === WebSocket.OPEN) {
      const { phase, elapsed_s, rate_hz, deadline_misses, ticks: all } = counters;
      status(`${phase} ${elapsed_s.toFixed(0)} s at ${rate_hz.toFixed(1)} Hz, ${deadline_misses} of ${all} samples late${noted(counters)}`);
    }
  }
  requestAnimationFrame(frame);
}
frame();
