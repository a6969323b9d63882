// Shows the drone's data and sends requests. Only the drone's data change the shown state.

import { angleAt, drawChart, drawVine, SHOWN_S } from "./drawing.js";
import { Link, Vent } from "./link.js";
import { ageWords, airWords, eventWords, firmwareWords, number, rcWords, sentence, vehicleWords } from "./words.js";

const STALE_S = 1.0;
const SURE_S = 4;
const MOST_EVENTS = 100; // of decisions, and of notices: many of one kind do not hide the other
const LOW_CYCLES = 10;
const DRAW_S = 0.25;
const CONFIRMED_S = 10;

const $ = (id) => document.getElementById(id);
const page = document.body.classList;
let vine = { profiles: {}, curve: [[0, 0], [1, 0]], max_kPa: 1, full_kPa: 1, bench_mode: false };
let latest = null;
let samples = [];
let drawnAt = 0;
let told = "";
let writtenReasons = "";
let ventTold = "";

// The token is now in a cookie: remove it from the address bar, where others could read it.
if (location.search) history.replaceState(null, "", location.pathname);

// Receiving.

function take(message) {
  if (message.kind === "hello") welcome(message);
  else if (message.kind === "snapshot") show(message.snapshot);
  else if (message.kind === "happened") note(message);
  else if (message.kind === "missed") addEvent(null, [["", `${message.count} events were lost on the way here`]]);
}

function welcome(hello) {
  vine = hello.vine;
  page.toggle("watching", !hello.may_ask);
  $("flights").hidden = !hello.flights;
  // After a restart of the gateway process, earlier samples are still valid.
  const first = hello.history.length ? hello.history[0][0] : hello.t;
  samples = [...samples.filter(([t]) => t < first), ...hello.history];
  $("events").replaceChildren();
  hello.happened.forEach(note);
  const angles = vine.curve.map(([, degrees]) => degrees);
  const [least, most] = [Math.min(...angles), Math.max(...angles)];
  if (Number($("angle").max) !== most || Number($("angle").min) !== least) {
    Object.assign($("angle"), { min: least, max: most, value: (least + most) / 2 });
    showAngle();
  }
  $("profiles").replaceChildren(
    ...Object.entries(vine.profiles).map(([name, degrees]) => {
      const made = button(name, () => request(name, "profile", null, name));
      made.append(element("small", "", degrees ? `to ${number(degrees, 0)}°` : "0°"));
      return made;
    }),
  );
  showControls();
  showVent();
}

function show(s) {
  latest = s;
  samples.push([s.t, s.cv_kPa, s.command_kPa, s.reservoir_kPa]);
  while (samples.length && s.t - samples[0][0] > SHOWN_S) samples.shift();
  write("doing", sentence(s.doing));
  writeReasons(Object.values(s.safe_state), Object.values(s.unstable), s.waiting);
  write("vehicle", vehicleWords(s));
  write("rc", rcWords(s));
  write("actuator", s.actuator);
  write("firmware", firmwareWords(s));
  write("bend", number(s.bend_deg, 0));
  write("cv", number(s.cv_kPa));
  write("command", number(s.command_kPa));
  write("reservoir", number(s.reservoir_kPa, 0));
  write("cycles", airWords(s.cycles));
  const share = Math.min(Math.max((s.reservoir_kPa ?? 0) / vine.full_kPa, 0), 1);
  $("level").style.transform = `scaleX(${share})`;
  const bar = document.querySelector(".bar");
  bar.setAttribute("aria-valuemax", vine.full_kPa);
  bar.setAttribute("aria-valuenow", Math.round(s.reservoir_kPa ?? 0));
  bar.classList.toggle("low", s.cycles !== null && s.cycles.expected < LOW_CYCLES);
  drawVine(document.querySelector("#vine svg"), s.bend_deg, s.command_kPa && angleAt(vine.curve, s.command_kPa));
  showControls();
  showVent();
}

function write(id, text) {
  // Write only changes, because a screen reader reads them aloud.
  if ($(id).textContent !== text) $(id).textContent = text;
}

// Red: faults. Amber: what comes and goes, what vented the vine, and the request that it waits for.
// Green: nothing is wrong.
function writeReasons(reasons, unstable, waiting) {
  const lines = reasons.map((reason) => ["bad", sentence(reason)]);
  lines.push(...unstable.map((reason) => ["warning", sentence(reason)]));
  if (waiting) {
    if (!reasons.length) lines.push(["warning", sentence(waiting.stopped_by)]);
    lines.push(["warning", `Waiting for: ${waiting.awaited}`]);
  }
  if (!lines.length) lines.push(["good", "Nothing is wrong"]);
  $("doing").className = `value ${reasons.length ? "bad" : waiting ? "warning" : ""}`;
  if (lines.join("\n") === writtenReasons) return;
  writtenReasons = lines.join("\n");
  $("reasons").replaceChildren(...lines.map(([style, line]) => element("li", style, line)));
}

function note(event) {
  const words = eventWords(event);
  if (words === null) return;
  const parts = words.verdict
    ? [["", words.text], [words.style, words.verdict], ["", words.reason]]
    : [[words.severity, words.text]];
  addEvent(event.fields.t, parts, event.what);
}

function addEvent(t, parts, kind = "notice") {
  const row = element("li", kind, "");
  const at = t === null ? new Date() : new Date(Date.now() - 1000 * (link.droneNow - t));
  row.append(element("span", "when", at.toLocaleTimeString("en-GB")));
  row.append(...parts.map(([style, text]) => element("span", style, text)));
  $("events").prepend(row);
  for (const old of [...$("events").getElementsByClassName(kind)].slice(MOST_EVENTS)) old.remove();
}

function element(kind, style, text) {
  const made = document.createElement(kind);
  made.className = style;
  made.textContent = text;
  return made;
}

function button(text, press) {
  const made = element("button", "", text);
  made.type = "button";
  made.onclick = press;
  return made;
}

// State of the link.

function look() {
  const stale = !link.open || link.age > STALE_S;
  page.toggle("stale", stale);
  page.toggle("lost", stale && latest !== null);
  page.toggle("connecting", stale && latest === null);
  const shown = latest === null ? "nothing shown yet" : `${ageWords(link.age)} old`;
  let state = "Live", words = "Live";
  if (!link.open) {
    state = link.refused || "No link";
    words = link.refused ? `No link: ${link.refused}` : `No link, ${shown}`;
  } else if (stale) {
    state = "The service is silent";
    words = `Service silent, ${shown}`;
  }
  write("link", words);
  $("link").title = words;
  if (state !== told) {
    told = state;
    write("announce", state === "Live" ? "The link is live" : `${state}: the shown data are old`);
    showControls();
  }
  showVent();
  const now = performance.now() / 1000;
  if (now - drawnAt >= DRAW_S && !document.hidden) {
    drawnAt = now;
    const end = Number.isFinite(link.droneNow) ? link.droneNow : (samples.at(-1)?.[0] ?? 0);
    drawChart($("chart"), samples, end, vine);
  }
}

// Requests.

const link = new Link(take, look);
const vent = new Vent(link);

async function request(title, command, value = null, name = null) {
  say("", `${title}: asking…`);
  const { safety, reason } = await link.ask(command, value, name);
  const words = safety === "unanswered" ? `${reason}: it is done already, or it will not be done` : safety;
  say(safety === "accepted" || safety === "limited" ? "good" : "bad",
    `${title}: ${words}${reason && safety !== "unanswered" ? `, ${reason}` : ""}`);
}

function say(style, text) {
  $("said").className = style;
  $("said").textContent = text;
}

function showControls() {
  const live = latest !== null && !page.contains("stale");
  const bench = live && !latest.armed && (latest.bench || vine.bench_mode);
  $("armed").setAttribute("aria-checked", Boolean(latest?.pneumatics_armed));
  $("bench-mode").setAttribute("aria-checked", Boolean(latest?.bench));
  for (const id of ["armed", "bench-mode"]) $(id).disabled = !live;
  $("clear").disabled = !live || Object.keys(latest.safe_state).length === 0;
  for (const each of [...$("profiles").children, $("bend-to"), $("angle")]) each.disabled = !bench;
}

function showAngle() {
  $("angle-shown").textContent = `${$("angle").value}°`;
}

// Two presses within a few seconds, for buttons that must not be pressed by mistake.
function pressTwice(pressed, question, act) {
  let sure = null;
  const calm = () => {
    clearTimeout(sure);
    sure = null;
    pressed.classList.remove("sure");
    pressed.replaceChildren(pressed.dataset.title);
  };
  pressed.dataset.title = pressed.textContent;
  pressed.onclick = () => {
    if (sure === null && question()) {
      pressed.classList.add("sure");
      pressed.replaceChildren(question());
      sure = setTimeout(calm, 1000 * SURE_S);
      return;
    }
    calm();
    act();
  };
}

pressTwice($("clear"), () => "Sure?", () => request("clear faults", "clear_faults"));
pressTwice(
  $("armed"),
  () => (latest.pneumatics_armed ? "" : "Sure?"),
  () => (latest.pneumatics_armed ? request("disarm", "disarm") : request("arm", "arm")),
);
$("bench-mode").onclick = () =>
  latest.bench ? request("leave bench mode", "stop_bench") : request("bench mode", "start_bench");
$("angle").oninput = showAngle;
$("bend-to").onclick = () => request(`bend ${$("angle").value}°`, "bend", Number($("angle").value));

// Venting.

function ventNow() {
  vent.press();
  showVent();
}

function showVent() {
  let style = "", words = "";
  if (latest && page.contains("stale")) words = "Vine pressure not known";
  else if (latest) words = latest.cv_kPa === null ? "Vine pressure not known" : `Vine at ${number(latest.cv_kPa)} kPa`;
  if (page.contains("watching")) words = "You may only watch";
  else if (vent.wanted) {
    style = "bad";
    const since = ageWords(performance.now() / 1000 - vent.since);
    words = `VENT not ${link.open ? "confirmed" : "sent, no link"}: trying ${since}`;
  } else if (vent.confirmedAfter !== null && performance.now() / 1000 - vent.since < vent.confirmedAfter + CONFIRMED_S) {
    style = vent.doubt ? "bad" : "good";
    words = vent.doubt
      ? `Vent sent, ${vent.doubt}`
      : `Vent confirmed in ${vent.confirmedAfter.toFixed(2)} s, ${number(latest?.cv_kPa ?? null)} kPa`;
  }
  $("vent-said").className = style;
  write("vent-said", words);
  if (style !== ventTold) {
    ventTold = style;
    if (style) write("announce", words);
  }
  page.toggle("trying", vent.wanted && performance.now() / 1000 - vent.since > 2);
}

$("vent").onclick = ventNow;
$("stop-trying").onclick = () => {
  vent.giveUp();
  showVent();
};
// If a button has the focus, Enter presses it, but space vents.
for (const kind of ["keydown", "keyup"]) window.addEventListener(kind, onKey, { capture: true });

function onKey(event) {
  if (event.ctrlKey || event.altKey || event.metaKey || page.contains("watching")) return;
  if (event.key !== "Escape" && event.key !== " ") return;
  event.preventDefault();
  event.stopPropagation();
  if (event.type === "keydown" && !event.repeat) ventNow();
}

showAngle();
look();
