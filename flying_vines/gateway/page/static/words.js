// Texts for the drone's data.

export const number = (value, digits = 1) => {
  if (value === null) return "–";
  const text = value.toFixed(digits);
  return (Number(text) === 0 ? text.replace("-", "") : text).replace("-", "−");
};

export const sentence = (text) => text && text[0].toUpperCase() + text.slice(1);

export const plain = (name) => name.replaceAll("_", " ");

// A parameter: a 32-bit float, so more digits would not be true. Null means that it is not used.
const param = (value) => (value === null ? "–" : Number(value.toPrecision(6)));

// Triggers that nobody requested: they vent or hold the vine. As in `core/events.py`.
const UNREQUESTED = ["failsafe", "link"];

// The details of a trigger, shown after its kind. `terminal/screen.py` shows the same details.
function details(what) {
  if ("channel" in what) return `ch${what.channel} position ${what.position}`;
  if ("loss" in what) return plain(what.loss);
  if ("event" in what) return what.event;
  const parts = [];
  if ("seq" in what) parts.push(`#${what.seq ?? "?"}`);
  if ("command" in what) parts.push(what.command);
  if (Array.isArray(what.params)) parts.push(`(${what.params.map(param).join(", ")})`);
  return parts.join(" ");
}

// Text, severity or verdict, and reason of an event; null if the event is not shown.
export function eventWords({ what, fields }) {
  if (what === "decision") {
    const request = [plain(fields.trigger), details(fields.what)].filter(Boolean).join(" ");
    const reason = fields.reason ? ` (${fields.reason})` : "";
    // A vent by a failsafe is not shown in green, the colour of accepted requests.
    const style = UNREQUESTED.includes(fields.trigger) && fields.safety === "accepted" ? "warning" : fields.safety;
    return { text: `${request} → ${fields.intent ?? "?"}: `, verdict: fields.safety, style, reason };
  }
  if (what === "notice" && !fields.of_decision) {
    const severity = fields.severity <= 3 ? "error" : fields.severity === 4 ? "warning" : "notice";
    return { text: fields.text, severity };
  }
  return null;
}

export function vehicleWords(s) {
  if (s.vehicle === "not found") return "not found";
  const up = s.altitude_m === null ? "height not known" : `${number(s.altitude_m)}\u00a0m\u00a0up`;
  return [s.vehicle, s.mode, s.armed ? "armed" : "disarmed", up].filter(Boolean).join(", ");
}

export function rcWords(s) {
  const position = s.switch_position === null ? "switch not read" : `position ${s.switch_position}`;
  return s.rc === "good" ? `good, ${position}` : s.rc;
}

export function firmwareWords(s) {
  if (s.firmware !== "ready") return s.firmware;
  const trip = s.round_trip_s === null ? "" : `, round trip ${number(1000 * s.round_trip_s)} ms`;
  const gaps = s.telemetry_gaps ? `, gaps in telemetry: ${s.telemetry_gaps}` : "";
  return `ready${trip}${gaps}`;
}

const LONGEST_MINUTES = 600;

const minutes = (value) => (value < LONGEST_MINUTES ? `${number(value, 0)} min` : "10 h or more");

// The air left: the number of bends like the last one, and the time that it lasts without a bend.
export function airWords(cycles) {
  if (!cycles) return "Bends left: not known";
  if (cycles.lost) return "0 bends left until you clear the fault: air is lost";
  const bends = (value) => number(value * cycles.per_cycle, 0);
  const like = cycles.measured_cycles > 0 ? "like the last, at this pace" : "a guess until the first bend";
  const least = cycles.minutes_low < LONGEST_MINUTES ? `, at least ${minutes(cycles.minutes_low)}` : "";
  return (
    `${bends(cycles.expected)} bends to ${number(cycles.bend_kPa, 0)} kPa left ` +
    `(${bends(cycles.low)} to ${bends(cycles.high)}), ${like}. ` +
    `Without a bend: ${minutes(cycles.minutes)}${least}.`
  );
}

export function ageWords(seconds) {
  if (seconds < 60) return `${seconds.toFixed(0)} s`;
  return seconds < 3600 ? `${(seconds / 60).toFixed(0)} min` : `${(seconds / 3600).toFixed(0)} h`;
}
