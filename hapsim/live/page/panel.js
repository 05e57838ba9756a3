// @ts-check
/** The page of a running scene. */

import { Connection } from "./connection.js";
import { makeControls, refuseAt } from "./controls.js";
import { short, shownIn } from "./drawing.js";
import { Dial } from "./dial.js";
import { Force } from "./force.js";
import { drawHistogram } from "./histogram.js";
import { Hold } from "./hold.js";
import { Picture } from "./picture.js";
import { Plane } from "./plane.js";
import { Save } from "./save.js";
import { Samples } from "./samples.js";
import { Scope } from "./scope.js";
import { Words } from "./words.js";

const MOST_EVENTS = 200;

/** @param {string} id @returns {any} */
const part = (id) => document.getElementById(id);
export const connection = new Connection();
export const samples = new Samples();
export const scope = new Scope(part("scope"), samples, showScope);
const plane = new Plane(part("plane"), part("felt"), part("note"));
const hold = new Hold((values) => demand("picture-part", values ? { type: "set", values, held: true } : { type: "release" }));
const save = new Save(part("save"), part("save-as"), (request) => demand("header", request), () => controls?.unsaved() ?? []);
const force = new Force(part("force"), part("force-note"), samples, hold);
const dial = new Dial(part("dial"), force);
const ofWords = new Words(part("words"), samples, (values) => connection.ask({ type: "set", values }));
export const picture = new Picture(part("picture"), part("picture-note"), hold, plot);
/** @type {any} */
let model = null;
/** @type {ReturnType<typeof makeControls> | null} */
let controls = null;
/** @type {{values: any, isApplied: boolean} | null} */
let wanted = null; // the newest prediction to ask for
let asked = { values: {}, isApplied: true }; // the last one,
let askedAt = 0; // when, ms,
/** @type {number[]} */
let askedFrom = []; // and where the hands were
let askedInputs = "";
const MOVED = 1e-4; // m or rad, by which a hand may meet another contact
let isAsking = false;
let isRecording = false;
let watched = ""; // the module on the scope
/** @type {any} */
let counters = null;
let ended = ""; // how
/** @type {Record<string, string>} */
let words = {}; // by counter: what follows its count

connection.addEventListener("open", begin);
connection.addEventListener("closed", (event) => status(ended || `not connected: ${/** @type {CustomEvent} */ (event).detail || "hapsim cannot be reached"}`, true));
connection.addEventListener("samples", (event) => samples.add(/** @type {CustomEvent} */ (event).detail));
connection.addEventListener("modules", (event) => samples.addModules(/** @type {CustomEvent} */ (event).detail));
connection.addEventListener("picture", (event) => picture.take(/** @type {CustomEvent} */ (event).detail));
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
  const modules = watched ? [watched] : [];
  await demand("scope-part", { type: "subscribe", rate: 60, history, modules, picture: !part("picture-part").hidden });
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
  const isOfWords = (/** @type {string} */ name) => /^(outputs|mock\.inputs)\./.test(name);
  const parameters = model.parameters.filter((/** @type {any} */ one) => !isOfWords(one.name)).map((/** @type {any} */ one) => ({ ...one, shown: shownIn(one.unit, model.written) }));
  controls = makeControls(part("parameters"), parameters, (values) => predict(values, false), apply);
  over(model.phase === "ended" ? "ended" : "");
  part("go-on").hidden = !model.can_go_on;
  if (model.phase === "waiting") {
    counters = null;
    status(model.can_go_on ? "paused: this machine was too slow" : "nothing runs yet, or the device is awaited", true);
  }
  part("record").hidden = !model.can_record;
  recording(Boolean(model.recording));
  lease(model.lease);
  for (const [view, its] of [["force", "force-part"], ["picture", "picture-part"]]) part(its).hidden = !model.views.includes(view);
  part("words-part").hidden = !model.words.length;
  for (const one of [hold, save, force, dial, picture, ofWords]) one.describe(model);
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

/** Plots a point or a mass in the scope; one of the plane by x and y in turns. @param {string} name */
function plot(name) {
  const options = [...part("what").options].map((one) => one.value), [module, ...place] = name.split(".");
  const hand = model.channels.filter((/** @type {any} */ one) => one.name === name || one.name.startsWith(`${name}.`)).map((/** @type {any} */ one) => `0 ${one.channel}`);
  const own = [...hand, `module ${name}`, `module ${name}.x`, `module ${name}.y`, `module ${module}`].filter((one) => options.includes(one));
  part("what").value = own[(own.indexOf(part("what").value) + 1) % own.length];
  if (place.length) [part("place").value, part("place").dataset.of] = [place.join("."), module];
  choose();
}

/** @param {any} message */
function count(message) {
  counters = message.progress;
  drawHistogram(part("exchange"), "Exchange", message.exchange);
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
      [askedAt, askedFrom, askedInputs] = [performance.now(), at, ofWords.inputs()];
      const answer = await connection.ask({ type: "predict", values: asked.values, at, hand: plane.hand, plane: true, curve: model.views.includes("force") });
      if (answer.type === "predicted") {
        feel(answer, asked.isApplied);
        refuseAt(part("plane-part"), "");
      } else if (!controls?.refuse(asked.values, answer.reason, false)) refuseAt(part("plane-part"), `Not predicted: ${answer.reason}`);
    }
  } finally {
    isAsking = false;
  }
}

/** Where a hand is, within its travel. @param {number} channel */
function place(channel) {
  const [low, high] = model.channels[channel]?.travel ?? [null, null];
  const x = samples.position(channel);
  return Math.min(Math.max(x, low ?? -Infinity), high ?? Infinity);
}

/** @returns {number[]} */
const places = () => model.channels.map((/** @type {any} */ _, /** @type {number} */ channel) => place(channel));

/** Asks anew where the hand has left the region that is shown, or has moved while it may touch masses, or where an input
 * was switched, at most five times a second: faster figures are not read. */
function follow() {
  const region = plane.applied?.hands?.[plane.hand]?.region;
  const moves = plane.applied?.contacts || model.space > 1; // what it touches
  const isSwitched = ofWords.inputs() !== askedInputs;
  if (!(region || moves || isSwitched) || isAsking || performance.now() < askedAt + 200) return;
  const x = place(plane.channel), low = region?.low_m ?? -Infinity, high = region?.high_m ?? Infinity;
  const isAway = moves && places().some((at, i) => Math.abs(at - (askedFrom[i] ?? 0)) > MOVED);
  if (x < low || x > high || isAway || isSwitched) predict(asked.values, asked.isApplied);
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
  if (model.views.includes("force")) force.show(predicted, isApplied, plane.channel);
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

/** Shows whether the lease ran out. @param {{ seconds: number | null, out: number }} state */
function lease(state) {
  for (const name of ["renew", "end-lease"]) part(name).hidden = !state.out;
  part("fallback").hidden = !state.out;
  part("fallback").textContent = `the lease of ${state.seconds} s ran out: the fallback holds the hand`;
}

/** @param {any} event */
function receive(event) {
  if (event.kind === "changed" && Object.keys(event.values).length) {
    controls?.show(event.values);
    ofWords.take(event.values);
    save.draw();
    if (!Object.keys(event.values).every((name) => /^(mock|outputs)\./.test(name))) predict({}, true);
    return;
  }
  if (event.kind === "place") return force.placed(event.values); // of a detent: there may be a hundred a second
  if (event.kind === "changed" || event.kind === "armed") begin();
  if (["lost", "paused", "saved"].includes(event.kind)) describe();
  if (event.kind === "ended") over(`ended: ${event.sentence || "as asked"}`);
  if (event.kind === "recording" || event.kind === "recorded") recording(event.kind === "recording");
  if (event.kind === "lease") lease(event.values);
  if (event.kind !== "rejected" || !Object.keys(event.values).length) list(event); // a client's own is shown where it asked
}

/** @param {any} event */
function list(event) {
  const item = document.createElement("li"), kind = document.createElement("span");
  kind.className = ["lost", "paused", "guard", "rejected"].includes(event.kind) ? "kind bad" : "kind";
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

/** Shows how the run ended, until there is another; nothing can be asked meanwhile. @param {string} how "" while it has not */
function over(how) {
  ended = how;
  for (const one of document.querySelectorAll("header button")) /** @type {HTMLButtonElement} */ (one).disabled = Boolean(how);
  if (!how) return;
  [part("go-on").hidden, counters] = [true, null];
  status(how, true);
}

/** @param {string} text @param {boolean} [isBad] */
function status(text, isBad = false) {
  part("status").textContent = part("count").textContent = text; // a phone has the second alone
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
part("click").onclick = () => {
  const channel = scope.what?.channel ?? 0;
  const force = 0.2 * model.channels[channel].force_limit;
  return demand("scope-part", { type: "pulse", channel, shape: "click", force, seconds: 0.01 });
};
part("marker").onclick = () => demand("header", { type: "marker", text: "from the page" });
part("go-on").onclick = () => demand("header", { type: "go_on" });
part("renew").onclick = () => demand("header", { type: "lease" });
part("end-lease").onclick = () => demand("header", { type: "lease", seconds: 0 });
part("stop").onclick = () => demand("header", { type: "stop" });
part("record").onclick = () => demand("header", { type: "record", on: !isRecording });
addEventListener("keydown", (event) => {
  const isTyping = event.target instanceof HTMLInputElement && event.target.type !== "range";
  if (event.shiftKey && (event.code === "Space" || event.key === " ")) { // two keys: one is pressed by accident
    event.preventDefault(); // it stops the force, whatever has the focus
    part("stop").click();
  } else if (!isTyping && event.key === "f") part("freeze").click();
  else if (!isTyping && event.key === "m") part("marker").click();
});

function frame() {
  if (model) {
    hold.send();
    scope.draw();
    follow();
    plane.draw();
    force.draw();
    dial.draw();
    picture.draw();
    ofWords.draw();
    if (counters && connection.socket?.readyState === WebSocket.OPEN) {
      const { phase, elapsed_s, rate_hz, deadline_misses, ticks: all } = counters;
      status(`${phase} ${elapsed_s.toFixed(0)} s at ${rate_hz.toFixed(1)} Hz, ${deadline_misses} of ${all} samples late${noted(counters)}`);
    }
  }
  requestAnimationFrame(frame);
}
frame();
