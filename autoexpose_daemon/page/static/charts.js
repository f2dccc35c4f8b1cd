// Drawing: lanes of history, and the prediction curve. Sizes are CSS pixels.

import * as format from "./format.js";

// Lengths of the time axis with their steps: the shortest that holds the history.
const STEPS_S = new Map([[30, 10], [60, 15], [120, 30], [300, 60]]);
const LENGTHS_S = [...STEPS_S.keys()];
const GAP_S = 2.5; // while nobody watches, points come once a second, from the status
const LEFT = 52;
const BOTTOM = 17;
const FONT = "11px system-ui, sans-serif";

// Columns of a row: 0 the time, then [least, greatest] of the applied values and of those requested.
export const LANES = [
  { name: "exposure time", applied: 1, asked: 5, words: format.micros, log: true, span: 1.4 },
  { name: "gain", applied: 2, asked: 6, words: format.decibels, span: 2, floor: 0 },
  { name: "exposure level, stops", applied: 3, asked: 7, words: format.stops, span: 1 },
  { name: "metric", applied: 4, words: format.metric, span: 0.01, floor: 0, fromZero: true },
];

export function begin(canvas) {
  const scale = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = Math.round(width * scale);
  canvas.height = Math.round(height * scale);
  const pen = canvas.getContext("2d");
  pen.scale(scale, scale);
  pen.font = FONT;
  return { pen, width, height, colour: palette() };
}

// Maps the names of the page's colours to their present values, light or dark.
export function palette() {
  const style = getComputedStyle(document.documentElement);
  return (name) => style.getPropertyValue(`--${name}`).trim();
}

// Round numbers within [low, high], two to five of them.
function linearTicks(low, high) {
  const rough = (high - low) / 4;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 2.5, 5, 10].find((factor) => factor * power >= rough);
  const ticks = [];
  for (let n = Math.ceil(low / step - 1e-9); n * step <= high + 1e-9 * step; n++) ticks.push(n * step);
  return ticks;
}

// As few as make three, or else evenly spaced ones.
function logTicks(low, high) {
  for (const few of [[1], [1, 3], [1, 2, 5], [1, 2, 3, 5, 7]]) {
    const ticks = [];
    for (let power = 10 ** Math.floor(Math.log10(low)); power <= high; power *= 10) {
      ticks.push(...few.map((factor) => factor * power).filter((tick) => tick >= low && tick <= high));
    }
    if (ticks.length >= 3) return ticks;
  }
  return linearTicks(low, high);
}

function tickWords(lane, tick) {
  if (!lane.log) return String(Number(tick.toPrecision(3)));
  const plain = (number) => String(Number(number.toPrecision(3)));
  return tick < 1000 ? `${plain(tick)} µs` : `${plain(tick / 1000)} ms`;
}

function bounds(lane, rows) {
  let [low, high] = [Infinity, -Infinity];
  for (const row of rows) {
    for (const range of [row[lane.applied], lane.asked && row[lane.asked]]) {
      if (range) [low, high] = [Math.min(low, range[0]), Math.max(high, range[1])];
    }
  }
  if (low > high) return null;
  if (lane.log) {
    const middle = Math.sqrt(low * high);
    return [Math.min(low / 1.12, middle / lane.span), Math.max(high * 1.12, middle * lane.span)];
  }
  if (lane.fromZero) low = 0;
  const missing = Math.max(lane.span - (high - low), 0) / 2;
  const margin = 0.08 * Math.max(high - low, lane.span);
  const bottom = low - missing - margin;
  return [lane.floor === undefined ? bottom : Math.max(bottom, lane.floor - margin / 2), high + missing + margin];
}

// `firstS`: when the oldest point was, Infinity without any.
export function lengthOf(firstS, nowS) {
  const wantedS = Math.max(nowS - firstS, 0);
  return LENGTHS_S.find((length) => length >= wantedS) ?? LENGTHS_S.at(-1);
}

export function drawLane(canvas, lane, rows, { nowS, lengthS, hoverS }) {
  const { pen, width, height, colour } = begin(canvas);
  const right = width - 1;
  const bottom = height - BOTTOM;
  const x = (timeS) => right - ((nowS - timeS) / lengthS) * (right - LEFT);
  pen.textBaseline = "middle";
  pen.fillStyle = colour("quiet");
  pen.strokeStyle = colour("rule");
  pen.textAlign = "center";
  for (let agoS = 0; agoS <= lengthS; agoS += STEPS_S.get(lengthS)) {
    const at = Math.round(x(nowS - agoS)) + 0.5;
    pen.textAlign = agoS === 0 ? "right" : "center";
    pen.fillText(agoS === 0 ? "now" : `−${agoS % 60 ? `${agoS} s` : `${agoS / 60} min`}`, at, height - 7);
    line(pen, [[at, 2], [at, bottom]]);
  }
  const range = bounds(lane, rows);
  if (!range) return;
  const place = lane.log ? Math.log : (value) => value;
  const [low, high] = range.map(place);
  const y = (value) => bottom - ((place(value) - low) / (high - low)) * (bottom - 4);
  pen.textAlign = "right";
  for (const tick of lane.log ? logTicks(...range) : linearTicks(...range)) {
    const at = Math.round(y(tick)) + 0.5;
    line(pen, [[LEFT, at], [right, at]]);
    pen.fillText(tickWords(lane, tick), LEFT - 6, at);
  }
  if (lane.asked) band(pen, rows, lane.asked, x, y, colour("asked"), 4);
  band(pen, rows, lane.applied, x, y, colour("applied"), 1.8);
  if (hoverS !== null) {
    pen.strokeStyle = colour("ink");
    line(pen, [[x(hoverS), 2], [x(hoverS), bottom]]);
  }
}

// Draws each half second from its least to its greatest value, joined to the next where the two overlap or come nearest.
function band(pen, rows, column, x, y, colour, width) {
  pen.save();
  pen.beginPath();
  pen.rect(LEFT, 0, 1e5, 1e5);
  pen.clip();
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.lineCap = "round";
  pen.beginPath();
  let last = null;
  for (const row of rows) {
    if (!row[column]) continue;
    const [low, high] = row[column];
    if (last !== null && row[0] - last[0] <= GAP_S) {
      const [lastLow, lastHigh] = last[column];
      const common = Math.min(Math.max(low, lastLow), high, lastHigh);
      pen.moveTo(x(last[0]), y(Math.min(Math.max(common, lastLow), lastHigh)));
      pen.lineTo(x(row[0]), y(Math.min(Math.max(common, low), high)));
    }
    pen.moveTo(x(row[0]), y(low));
    pen.lineTo(x(row[0]), y(high));
    last = row;
  }
  pen.stroke();
  pen.restore();
}

export function line(pen, points) {
  pen.beginPath();
  for (const [x, y] of points) pen.lineTo(x, y);
  pen.stroke();
}

// The time under the pointer, or null outside the lane.
export function timeAt(canvas, offsetX, nowS, lengthS) {
  const share = (offsetX - LEFT) / (canvas.clientWidth - 1 - LEFT);
  return share < 0 || share > 1 ? null : nowS - (1 - share) * lengthS;
}

export function drawCurve(canvas, curve) {
  const { pen, width, height, colour } = begin(canvas);
  const [left, right, top, bottom] = [LEFT - 8, width - 8, 22, height - 30];
  const greatest = Math.max(...curve.metrics, 0.01) * 1.1;
  const x = (change) => left + ((change + 2) / 4) * (right - left);
  const y = (value) => bottom - (value / greatest) * (bottom - top);
  pen.textBaseline = "middle";
  pen.fillStyle = colour("quiet");
  pen.strokeStyle = colour("rule");
  for (let change = -2; change <= 2; change++) {
    pen.textAlign = "center";
    pen.fillText(change === 0 ? "0" : `${change > 0 ? "+" : "−"}${Math.abs(change)}`, x(change), bottom + 10);
    line(pen, [[x(change), top], [x(change), bottom]]);
  }
  pen.fillText("change of exposure, stops", (left + right) / 2, height - 7);
  pen.textAlign = "right";
  for (const tick of linearTicks(0, greatest)) {
    line(pen, [[left, y(tick)], [right, y(tick)]]);
    pen.fillText(String(Number(tick.toPrecision(3))), left - 6, y(tick));
  }
  pen.strokeStyle = colour("applied");
  pen.lineWidth = 2.2;
  pen.lineJoin = "round";
  line(pen, curve.delta_levels.map((change, index) => [x(change), y(curve.metrics[index])]));
  mark(pen, x(0), y(at(curve, 0)), top, bottom, colour("applied"), "taken", curve.decided_level >= curve.level);
  if (curve.decided_level !== null) {
    const change = Math.min(Math.max(curve.decided_level - curve.level, -2), 2);
    mark(pen, x(change), y(at(curve, change)), top, bottom, colour("asked"), "decided", change < 0);
  }
}

function mark(pen, x, y, top, bottom, colour, word, leftwards) {
  pen.strokeStyle = pen.fillStyle = colour;
  pen.lineWidth = 1.5;
  pen.setLineDash([4, 3]);
  line(pen, [[x, top - 6], [x, bottom]]);
  pen.setLineDash([]);
  pen.beginPath();
  pen.arc(x, y, 4.5, 0, 7);
  pen.fill();
  pen.textAlign = leftwards ? "right" : "left";
  pen.fillText(word, x + (leftwards ? -5 : 5), top - 11);
}

// The curve at a change of level, with straight lines between its points.
export function at(curve, change) {
  const { delta_levels: changes, metrics } = curve;
  const above = Math.max(changes.findIndex((each) => each >= change), 1);
  const share = (change - changes[above - 1]) / (changes[above] - changes[above - 1]);
  return metrics[above - 1] + share * (metrics[above] - metrics[above - 1]);
}
