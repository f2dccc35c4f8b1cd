// One web socket: numbers arrive twice a second, pictures on request. A hidden tab closes it.

import { bestLevel, drawBelief } from "./belief.js";
import { showButtons } from "./buttons.js";
import { at, drawCurve, drawLane, lengthOf, timeAt } from "./charts.js";
import * as format from "./format.js";
import { cards, figures, lanes, layOut } from "./layout.js";
import { define, element, policyWords, showDecision, showStatus } from "./numbers.js";
import { drawMatches, showRepetition } from "./repetition.js";

const SILENT_S = 3; // the daemon sends its status once a second
const STALE_S = 2;
const HISTORY_S = 300;
const CROWDED = 4001; // as in live.py
const byId = (id) => document.getElementById(id);

let socket = null;
let retryMs = 500;
let crowded = false;
let numbers = null; // the latest message, and when it arrived
let heardMs = 0;
let rows = {}; // of the history, by group
let pairMs = null;
const shownMs = new Map(); // when the newest picture of each camera came
let hoverS = null;

const sinceMs = (moment) => performance.now() - moment;

function connect() {
  if (socket || document.hidden) return;
  const opened = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  opened.binaryType = "arraybuffer";
  socket = opened;
  opened.onopen = () => opened.send("next");
  opened.onmessage = async (message) => {
    if (typeof message.data === "string") return takeNumbers(JSON.parse(message.data));
    try {
      await takePair(message.data);
    } finally {
      if (opened.readyState === WebSocket.OPEN) opened.send("next");
    }
  };
  opened.onclose = ({ code }) => {
    if (socket !== opened) return; // closed because hidden
    socket = null;
    numbers = null;
    crowded = code === CROWDED;
    showState();
    setTimeout(connect, retryMs);
    retryMs = Math.min(2 * retryMs, 8000);
    askForLogin();
  };
}

// If the token is no longer valid, the page itself redirects to the login.
async function askForLogin() {
  const answer = await fetch("/", { headers: { accept: "text/html" } }).catch(() => null);
  if (answer?.redirected) location.assign(answer.url);
}

document.addEventListener("visibilitychange", () => {
  if (!document.hidden) return connect();
  const closing = socket;
  socket = null;
  closing?.close();
});

function takeNumbers(message) {
  numbers = message;
  heardMs = performance.now();
  retryMs = 500;
  if (message.status) {
    const { groups, tracking } = message.status;
    layOut(namesOf(groups), hover);
    showStatus(message.status, message.tables);
    for (const [name, card] of cards) {
      card.querySelector(".policy").textContent = policyWords(groups[name], cards.size === 1 ? tracking : null);
    }
    showButtons(message.policies, message.status);
  }
  rows = Object.fromEntries([...cards.keys()].map((group) => [group, continued(group, message)]));
  showState();
  showHistory();
  showPromises(message.promises);
}

const namesOf = (groups) => Object.fromEntries(Object.entries(groups).map(([name, { cameras }]) => [name, cameras]));

// The rows of a group, with those that are new.
function continued(group, { history, now_s: nowS }) {
  const news = history[group] ?? [];
  const first = news[0]?.[0] ?? Infinity;
  const oldest = nowS - HISTORY_S;
  return (rows[group] ?? []).filter((row) => row[0] < first && row[0] >= oldest).concat(news);
}

// Word, colour and reasons.
function judged() {
  if (!numbers && crowded) return ["offline", "no connection", ["too many browsers watch already; trying again"]];
  if (!numbers) return ["offline", "no connection", ["the page's server does not answer; trying again"]];
  const { status, silent_s: saidS, trouble, rig } = numbers;
  if (!status && trouble) {
    return ["waiting", "waiting", ["is the daemon running, with publish: {} in its configuration?", trouble]];
  }
  if (!status) {
    return ["waiting", "waiting", [`no status from a rig named ${rig}: is that its publish.rig?`]];
  }
  const silentS = saidS + sinceMs(heardMs) / 1000;
  if (status.ending && silentS > 1) return ["ended", "ended", [`the daemon stopped ${format.lasting(silentS)} ago`]];
  if (silentS > SILENT_S) return ["silent", "silent", [`nothing heard from the daemon for ${format.lasting(silentS)}`]];
  return [status.state, status.state, status.reasons];
}

function showState() {
  const [state, word, reasons] = judged();
  byId("state").dataset.state = state;
  byId("state-word").textContent = word;
  byId("reasons").replaceChildren(...reasons.map((reason) => element("li", reason)));
  document.title = `${word} · autoexpose${numbers ? ` ${numbers.rig}` : ""}`;
  for (const card of cards.values()) fade(card, pairMs);
  for (const [camera, figure] of figures) {
    const staleS = fade(figure, shownMs.get(camera));
    const gone = numbers?.status?.cameras[camera]?.camera === null ? "camera gone, " : "";
    const since = staleS === null ? "no picture yet" : `no picture for ${format.lasting(staleS)}`;
    figure.querySelector(".screen p").textContent = gone + since;
  }
}

// Fades what is old; returns its age in seconds, or null if there is nothing yet.
function fade(place, moment) {
  const ageS = moment == null ? null : sinceMs(moment) / 1000;
  place.classList.toggle("stale", ageS === null || ageS > STALE_S);
  return ageS;
}
setInterval(showState, 1000);

async function takePair(data) {
  const length = new DataView(data).getUint32(0, true);
  const pair = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  let start = 4 + length;
  const decoded = [];
  for (const { jpeg_bytes: length } of pair.pictures) {
    decoded.push(createImageBitmap(new Blob([new Uint8Array(data, start, length)], { type: "image/jpeg" })));
    start += length;
  }
  const bitmaps = await Promise.all(decoded);
  if (!numbers?.status) layOutBy(pair);
  pair.pictures.forEach((picture, index) => showPicture(picture, bitmaps[index], pair.registered));
  showRepetition(pair.registered);
  pairMs = performance.now();
  for (const [group, card] of cards) showDecision(card, pair.decisions[group]);
  showState();
  document.body.dataset.trigger = pair.trigger;
}

// Before the daemon has told what rig it has.
function layOutBy({ pictures, decisions }) {
  const cameras = pictures.map(({ camera }) => camera);
  layOut(Object.fromEntries(Object.keys(decisions).map((group) => [group, cameras])), hover);
}

function showPicture(picture, bitmap, registered) {
  const figure = figures.get(picture.camera);
  if (!figure) return bitmap.close(); // of a camera that the latest status does not have
  shownMs.set(picture.camera, performance.now());
  const canvas = figure.querySelector("canvas");
  if (canvas.width !== bitmap.width || canvas.height !== bitmap.height) {
    [canvas.width, canvas.height] = [bitmap.width, bitmap.height];
    canvas.parentElement.style.aspectRatio = `${bitmap.width} / ${bitmap.height}`;
  }
  canvas.getContext("2d").drawImage(bitmap, 0, 0);
  if (registered?.camera === picture.camera) drawMatches(canvas, registered, bitmap.width / picture.frame_width);
  bitmap.close();
  const title = element("h2", picture.camera);
  title.append(" ", element("small", numbers?.status?.cameras[picture.camera]?.camera ?? ""));
  const values = element("dl");
  define(values, [
    ["exposure", format.micros(picture.exposure_time_us)],
    ["gain", format.decibels(picture.gain_db)],
    ["metric", format.metric(picture.metric)],
    ["saturated", format.share(picture.saturated_share), "saturated"],
    ["black", format.share(picture.black_share), "black"],
  ]);
  figure.querySelector("figcaption").replaceChildren(title, values);
}

// What decides for each group, if its policy has a belief, or else the prediction.
function showPromises(promises) {
  for (const [group, card] of cards) {
    const { grounds, curve } = promises[group] ?? {};
    if (!grounds && !curve) continue;
    card.querySelector(".belief-title").hidden = !grounds;
    card.querySelector(".curve-title").hidden = Boolean(grounds);
    const words = grounds ? showBelief(card, grounds) : showCurve(card, curve);
    card.querySelector(".curve-words").textContent = words;
  }
}

function showBelief(card, grounds) {
  drawBelief(card.querySelector(".curve"), grounds);
  const best = bestLevel(grounds);
  const change = format.signed(best - grounds.level);
  const plan = change === "±0" ? "there, too" : `at ${format.stops(best)} (${change})`;
  return `taken at level ${format.stops(grounds.level)}; the best plan begins ${plan}`;
}

function showCurve(card, curve) {
  drawCurve(card.querySelector(".curve"), curve);
  const greatest = Math.max(...curve.metrics);
  const best = curve.delta_levels[curve.metrics.indexOf(greatest)];
  const decided = curve.decided_level === null ? "" : `, decided ${format.signed(curve.decided_level - curve.level)}`;
  const taken = `taken at level ${format.stops(curve.level)} with metric ${format.metric(at(curve, 0))}${decided}`;
  if (!curve.decides) return `${taken}; only to compare with: the policy does not go by this metric`;
  return `${taken}; ${greatest > 0 ? `predicted best at ${format.signed(best)} stops` : "no gradient at any exposure"}`;
}

const length = () => lengthOf(Math.min(...Object.values(rows).map((each) => each[0]?.[0] ?? Infinity)), numbers.now_s);

function hover(canvas, offsetX) {
  hoverS = offsetX === null || !numbers ? null : timeAt(canvas, offsetX, numbers.now_s, length());
  showHistory();
}

function showHistory() {
  if (!numbers) return;
  const view = { nowS: numbers.now_s, lengthS: length(), hoverS };
  for (const { group, lane, canvas, value } of lanes) {
    const ofGroup = rows[group] ?? [];
    canvas.parentElement.hidden = ofGroup.length > 0 && !ofGroup.some((row) => row[lane.applied]);
    const chosen = hoverS === null ? ofGroup.at(-1) : ofGroup.findLast((row) => row[0] <= hoverS);
    drawLane(canvas, lane, ofGroup, view);
    value.textContent = chosen ? valueWords(lane, chosen) : "";
  }
}

function valueWords(lane, row) {
  const words = (range) => (range ? format.range(range, lane.words) : "–");
  const asked = lane.asked ? words(row[lane.asked]) : "";
  const applied = words(row[lane.applied]);
  return asked && asked !== applied && asked !== "–" ? `${applied}, requested ${asked}` : applied;
}

function redraw() {
  showHistory();
  if (numbers) showPromises(numbers.promises);
}
addEventListener("resize", redraw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
layOut({ all: ["left", "right"] }, hover); // until it is known what rig there is
connect();
