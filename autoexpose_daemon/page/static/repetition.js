// What `autoexpose repeat` sees: its progress along the path, the vote of its matches, and the matches on the picture.

import { begin, line, palette } from "./charts.js";
import * as format from "./format.js";

const BIN_PX = 10; // as `repeat` votes
const byId = (id) => document.getElementById(id);

export function showRepetition(view) {
  byId("repetition").hidden = view === null;
  if (view === null) return;
  byId("repetition-words").textContent = words(view);
  drawPath(byId("path"), view);
  drawVote(byId("vote"), view);
}

function words(view) {
  const votes = view.matches[3].filter(Boolean).length;
  const shift = view.shift_px === null ? "not registered" : `shifted ${pixels(view.shift_px)}`;
  const drive = view.stopped
    ? `stopped: ${view.stopped}`
    : `${view.forward_m_s.toFixed(2)} m/s, ${format.signed(view.turn_rad_s)} rad/s`;
  return (
    `${view.distance_m.toFixed(1)} of ${view.length_m.toFixed(1)} m, local map ${view.local_map}, ${shift}, ` +
    `${votes} of ${view.matches[3].length} matches agree, ${drive}`
  );
}

const pixels = (shift) => `${shift < 0 ? "−" : "+"}${Math.abs(shift).toFixed(0)} px`;

function drawPath(canvas, view) {
  const { pen, width, height, colour } = begin(canvas);
  const [y, end] = [height / 2, width - 8];
  const x = 8 + Math.min(Math.max(view.distance_m / view.length_m, 0), 1) * (end - 8);
  pen.lineWidth = 4;
  pen.lineCap = "round";
  pen.strokeStyle = colour("rule");
  line(pen, [[8, y], [end, y]]);
  pen.strokeStyle = pen.fillStyle = colour(view.shift_px === null ? "asked" : "applied");
  line(pen, [[8, y], [x, y]]);
  pen.beginPath();
  pen.arc(x, y, 6, 0, 7);
  pen.fill();
}

// How many matches are shifted how far; those that agreed stand out.
function drawVote(canvas, view) {
  const { pen, width, height, colour } = begin(canvas);
  const [, , shifts, agreed] = view.matches;
  const furthest = Math.max(100, ...shifts.map(Math.abs));
  const bins = 2 * Math.ceil(furthest / BIN_PX);
  const counts = Array.from({ length: bins }, () => [0, 0]);
  shifts.forEach((shift, n) => {
    counts[Math.min(Math.floor(shift / BIN_PX) + bins / 2, bins - 1)][agreed[n] ? 0 : 1] += 1;
  });
  const most = Math.max(10, ...counts.map(([yes, no]) => yes + no));
  const [bottom, step] = [height - 17, width / bins];
  counts.forEach(([yes, no], n) => {
    const tall = (count) => (count / most) * (bottom - 14);
    pen.fillStyle = colour("match");
    pen.fillRect(n * step, bottom - tall(yes), Math.max(step - 1, 1), tall(yes));
    pen.fillStyle = colour("asked");
    pen.fillRect(n * step, bottom - tall(yes) - tall(no), Math.max(step - 1, 1), tall(no));
  });
  pen.strokeStyle = colour("rule");
  line(pen, [[0, bottom], [width, bottom]]);
  pen.fillStyle = colour("quiet");
  pen.textBaseline = "middle";
  for (const [share, align] of [[0, "left"], [0.5, "center"], [1, "right"]]) {
    pen.textAlign = align;
    const shift = Math.round((share - 0.5) * bins * BIN_PX);
    pen.fillText(shift === 0 ? "0 px" : pixels(shift), share * width, height - 7);
  }
  pen.textAlign = "left";
  pen.fillText(`${most} matches`, 2, 7);
}

// Dots where matches lie in the picture, with a line to where the map has them.
export function drawMatches(canvas, view, perPixel) {
  const pen = canvas.getContext("2d");
  const colour = palette();
  const [xs, ys, shifts, agreed] = view.matches;
  xs.forEach((x, n) => {
    const at = [x * perPixel, ys[n] * perPixel];
    pen.strokeStyle = pen.fillStyle = agreed[n] ? colour("match") : colour("asked");
    pen.lineWidth = 1.5;
    if (agreed[n]) line(pen, [at, [at[0] - shifts[n] * perPixel, at[1]]]);
    pen.beginPath();
    pen.arc(...at, agreed[n] ? 3 : 1.5, 0, 7);
    pen.fill();
  });
}
