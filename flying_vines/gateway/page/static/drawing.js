// Draws the vine and the last two minutes.

const LENGTH = 100;
const HALF_WIDTH = 6;
const PIECES = 24;

// The angle at a pressure, from the calibrated pairs of the configuration.
export function angleAt(curve, kPa) {
  let [before, angle] = curve[0];
  for (const [pressure, degrees] of curve) {
    if (kPa < pressure) return angle + ((degrees - angle) * Math.max(0, kPa - before)) / (pressure - before);
    [before, angle] = [pressure, degrees];
  }
  return angle;
}

// An arc of constant curvature that starts straight down: its axis, and its sides at a distance from the axis.
function points(degrees, across) {
  return Array.from({ length: PIECES + 1 }, (_, i) => {
    const length = (LENGTH * i) / PIECES;
    const turned = ((degrees * i) / PIECES / 180) * Math.PI;
    const bent = Math.abs(turned) > 1e-6;
    const x = bent ? ((1 - Math.cos(turned)) * length) / turned : 0;
    const y = bent ? (Math.sin(turned) * length) / turned : length;
    return `${(x + across * Math.cos(turned)).toFixed(1)} ${(y - across * Math.sin(turned)).toFixed(1)}`;
  });
}

function outline(degrees) {
  return `M${[...points(degrees, HALF_WIDTH), ...points(degrees, -HALF_WIDTH).reverse()].join("L")}z`;
}

export function drawVine(svg, bend, wanted) {
  const known = bend !== null;
  svg.querySelector("#body").setAttribute("d", known ? outline(bend) : "");
  svg.querySelector("#spine").setAttribute("d", known ? `M${points(bend, HALF_WIDTH).join("L")}` : "");
  svg.querySelector("#wanted").setAttribute("d", wanted === null ? "" : outline(wanted));
}

const SHOWN_S = 120;
const GAP_S = 1;
const LEFT = 40, RIGHT = 10, TOP = 22, BETWEEN = 30, BOTTOM = 22;

// Samples are [t, vine, setpoint, reservoir], gauge kPa or null; the right edge is now.
export function drawChart(canvas, samples, droneNow, vine) {
  const scale = window.devicePixelRatio || 1;
  const { clientWidth: width, clientHeight: height } = canvas;
  if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, width, height);
  const style = getComputedStyle(canvas);
  const color = (name) => style.getPropertyValue(`--${name}`);
  pen.font = `600 13px ${style.fontFamily}`;
  const inside = height - TOP - BETWEEN - BOTTOM;
  const upper = { top: TOP, height: 0.66 * inside, full: Math.ceil((1.05 * vine.max_kPa) / 5) * 5 };
  const lower = { top: TOP + upper.height + BETWEEN, height: 0.34 * inside, full: Math.ceil(vine.full_kPa / 100) * 100 };
  const x = (t) => width - RIGHT - ((droneNow - t) / SHOWN_S) * (width - LEFT - RIGHT);

  for (const pane of [upper, lower]) grid(pen, pane, x, droneNow, width, color, pane === lower);
  title(pen, LEFT, upper.top - 8, [["vine", color("vine")], ["setpoint", color("wanted")], ["kPa", color("soft")]]);
  title(pen, LEFT, lower.top - 8, [["reservoir", color("reservoir")], ["kPa", color("soft")]]);
  line(pen, samples, 2, upper, x, color("wanted"), [6, 4]);
  line(pen, samples, 1, upper, x, color("vine"), []);
  line(pen, samples, 3, lower, x, color("reservoir"), []);
}

function grid(pen, pane, x, droneNow, width, color, last) {
  pen.fillStyle = color("soft");
  pen.strokeStyle = color("grid");
  pen.lineWidth = 1;
  pen.beginPath();
  pen.textBaseline = "middle";
  pen.textAlign = "right";
  for (const value of [0, pane.full / 2, pane.full]) {
    const y = Math.round(pane.top + pane.height * (1 - value / pane.full)) + 0.5;
    pen.moveTo(LEFT, y);
    pen.lineTo(width - RIGHT, y);
    pen.fillText(Number(value.toFixed(1)), LEFT - 6, y);
  }
  for (let ago = 0; ago <= SHOWN_S; ago += 30) {
    const at = Math.round(x(droneNow - ago)) + 0.5;
    pen.moveTo(at, pane.top);
    pen.lineTo(at, pane.top + pane.height);
    if (!last || ago % 60) continue;
    pen.textAlign = ago === 0 ? "right" : ago === SHOWN_S ? "left" : "center";
    pen.fillText(ago === 0 ? "now" : `${ago / 60} min ago`, at, pane.top + pane.height + 13);
  }
  pen.stroke();
}

function title(pen, x, y, words) {
  pen.textAlign = "left";
  pen.textBaseline = "alphabetic";
  for (const [word, color] of words) {
    pen.fillStyle = color;
    pen.fillText(word, x, y);
    x += pen.measureText(`${word}  `).width;
  }
}

function line(pen, samples, column, pane, x, color, dashes) {
  pen.strokeStyle = color;
  pen.lineWidth = 2.5;
  pen.lineJoin = "round";
  pen.setLineDash(dashes);
  pen.beginPath();
  let before = -Infinity;
  for (const sample of samples) {
    const [t, value] = [sample[0], sample[column]];
    if (value === null) {
      before = -Infinity;
      continue;
    }
    const share = Math.min(Math.max(value / pane.full, 0), 1);
    pen[t - before > GAP_S ? "moveTo" : "lineTo"](Math.max(LEFT, x(t)), pane.top + pane.height * (1 - share));
    before = t;
  }
  pen.stroke();
  pen.setLineDash([]);
}

export { SHOWN_S };
