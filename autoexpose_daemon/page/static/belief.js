// The belief of a policy: the light of the scene, what the newest frame shows of it, and what exposures promise.

import { begin, line } from "./charts.js";

const LEFT = 4;
const RIGHT = 4;
const LOWEST_DRAWN = 0.02; // of the highest bin: the axis leaves out what is lower at its ends
const TICK_STOPS = [1, 2, 4]; // the first whose numbers are this far apart
const TICK_GAP = 24;
const LEAST_BEYOND = 70; // of the part beyond a limit, to name it
const HALF_TICK = 7; // of its number, which is left out where it would be cut
const HELD_STOPS = 0.05; // cameras round what is decided by less

export const bestLevel = ({ levels, value }) => levels[value.indexOf(Math.max(...value))];

// Each level stands below the middle of what its frame would show of the scene.
export function drawBelief(canvas, grounds) {
  const { pen, width, height, colour } = begin(canvas);
  const [scene] = Object.values(grounds.scenes);
  if (!scene) return;
  const [low, high] = range(scene);
  const x = (radiance) => LEFT + ((radiance - low) / (high - low)) * (width - RIGHT - LEFT);
  const middle = (scene.black + scene.white) / 2 + grounds.level;
  const floor = Math.round(0.58 * height);
  const best = bestLevel(grounds);
  const held = Math.abs(best - grounds.level) < HELD_STOPS;
  const marks = [[grounds.level, "applied", held ? "this frame, and the best" : "this frame", 14]];
  if (!held) marks.push([best, "asked", "the best", 32]);
  pen.save();
  pen.beginPath();
  pen.rect(LEFT, 0, width - RIGHT - LEFT, height);
  pen.clip();
  drawScene(pen, scene, x, 38, floor, colour);
  for (const [level, name, word, y] of marks) {
    const moved = grounds.level - level;
    drawWindow(pen, x(scene.black + moved), x(scene.white + moved), y, colour(name), word);
  }
  drawPromise(pen, grounds, (level) => x(middle - level), floor + 24, height - 30, colour, marks);
  pen.restore();
  pen.fillStyle = colour("quiet");
  pen.textAlign = "left";
  pen.fillText("dark", LEFT, floor + 9);
  pen.fillText("longer", LEFT, height - 7);
  pen.textAlign = "right";
  pen.fillText("bright", width - RIGHT, floor + 9);
  pen.fillText("shorter", width - RIGHT, height - 7);
  pen.textAlign = "center";
  pen.fillText("light of the scene", (LEFT + width) / 2, floor + 9);
  pen.fillText("exposure level, stops", (LEFT + width) / 2, height - 7);
}

// Radiance that is worth drawing.
function range({ start, bin_stops: bin, known, guessed, black, white }) {
  const heights = known.map((share, index) => share + guessed[index]);
  const drawn = heights.map((height) => height > LOWEST_DRAWN * Math.max(...heights));
  const [first, last] = [drawn.indexOf(true), drawn.lastIndexOf(true)];
  return [Math.min(start + first * bin, black) - 1, Math.max(start + (last + 1) * bin, white) + 1];
}

function drawScene(pen, scene, x, top, floor, colour) {
  const { start, bin_stops: bin, known, guessed, contrast } = scene;
  const highest = Math.max(...known.map((share, index) => share + guessed[index]), ...contrast, 0.01);
  const y = (share) => floor - (share / highest) * (floor - top);
  pen.fillStyle = colour("shown");
  pen.fillRect(x(scene.black), top, x(scene.white) - x(scene.black), floor - top);
  const bar = (index, from, to) =>
    pen.fillRect(x(start + index * bin), y(to), x(start + bin) - x(start), y(from) - y(to));
  known.forEach((share, index) => {
    pen.fillStyle = colour("known");
    bar(index, 0, share);
    pen.fillStyle = colour("guessed");
    bar(index, share, share + guessed[index]);
  });
  pen.strokeStyle = colour("contrast");
  pen.lineWidth = 1.5;
  const steps = contrast.flatMap((share, index) =>
    [0, 1].map((end) => [x(start + (index + end) * bin), y(share)]));
  line(pen, steps);
  pen.strokeStyle = colour("rule");
  pen.lineWidth = 1;
  line(pen, [[LEFT, floor + 0.5], [1e4, floor + 0.5]]);
}

// A bar from black to white.
function drawWindow(pen, black, white, y, colour, word) {
  pen.strokeStyle = pen.fillStyle = colour;
  pen.lineWidth = 2.5;
  for (const points of [[[black, y], [white, y]], [[black, y - 4], [black, y + 4]], [[white, y - 4], [white, y + 4]]]) {
    line(pen, points);
  }
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.fillText(word, (black + white) / 2, y - 7);
}

function drawPromise(pen, { levels, worth, value }, x, top, bottom, colour, marks) {
  const [least, greatest] = [Math.min(...value), Math.max(...value)];
  const y = (each) => bottom - ((each - least) / Math.max(greatest - least, 0.1)) * (bottom - top - 6);
  pen.fillStyle = colour("rule");
  pen.beginPath();
  pen.moveTo(x(levels[0]), bottom);
  levels.forEach((level, index) => pen.lineTo(x(level), bottom - worth[index] * (bottom - top - 6)));
  pen.lineTo(x(levels.at(-1)), bottom);
  pen.fill();
  pen.fillStyle = colour("quiet");
  pen.textAlign = "center";
  const [longest, shortest] = [x(levels.at(-1)), x(levels[0])]; // further left, exposures are longer than allowed
  if (longest - LEFT > LEAST_BEYOND) pen.fillText("not allowed", (LEFT + longest) / 2, (top + bottom) / 2);
  const end = pen.canvas.clientWidth - RIGHT;
  if (end - shortest > LEAST_BEYOND) pen.fillText("not allowed", (shortest + end) / 2, (top + bottom) / 2);
  const step = TICK_STOPS.find((stops) => (x(0) - x(stops)) >= TICK_GAP) ?? TICK_STOPS.at(-1);
  for (let tick = Math.ceil(levels[0] / step) * step; tick <= levels.at(-1); tick += step) {
    if (x(tick) > LEFT + HALF_TICK && x(tick) < pen.canvas.clientWidth - RIGHT - HALF_TICK) {
      pen.fillText(String(tick), x(tick), bottom + 9);
    }
  }
  pen.strokeStyle = colour("ink");
  pen.lineWidth = 1.8;
  pen.lineJoin = "round";
  line(pen, levels.map((level, index) => [x(level), y(value[index])]));
  for (const [level, name] of marks) {
    const nearest = levels.reduce((best, each, index) =>
      Math.abs(each - level) < Math.abs(levels[best] - level) ? index : best, 0);
    pen.strokeStyle = pen.fillStyle = colour(name);
    pen.lineWidth = 1;
    pen.setLineDash([3, 3]);
    line(pen, [[x(level), top - 6], [x(level), bottom]]);
    pen.setLineDash([]);
    pen.beginPath();
    pen.arc(x(level), y(value[nearest]), 4.5, 0, 7);
    pen.fill();
  }
}
