// Buttons that change control, on a page with a token.

import { element } from "./numbers.js";
import * as format from "./format.js";

const EV_STEP = 0.5;
const STATUS_MS = 3000;
const EVERY = "all groups";
const byId = (id) => document.getElementById(id);

let groups = {}; // as in the latest status, by name
let pressed = { ev_stops: 0, at_ms: -Infinity }; // what darker or brighter asked for: a status may not show it yet
let turn = Promise.resolve();

// The group that was chosen; null: every one.
function chosen() {
  const { value } = byId("group");
  return value in groups ? value : null;
}

const meant = () =>
  Object.entries(groups).flatMap(([name, group]) => ([null, name].includes(chosen()) ? [group] : []));

// What all of them have; undefined if they differ.
function common(values) {
  return values.every((value) => value === values[0]) ? values[0] : undefined;
}

// One after another: the last press applies.
function ask(changes) {
  const group = chosen();
  turn = turn.then(() => send(group === null ? changes : { group, ...changes }));
}

async function send(changes) {
  const answer = await fetch("/control", { method: "POST", body: JSON.stringify(changes) }).catch(() => null);
  byId("asked").textContent = answer ? await answer.text() : "the page's server does not answer";
  byId("asked").classList.toggle("refused", !answer?.ok);
  if (!answer?.ok || changes.reset) pressed.at_ms = -Infinity;
}

const allLocked = () => meant().every(({ requests }) => requests.locked);
const commonEv = () => common(meant().map(({ requests }) => requests.ev_stops));

function addEv(stops) {
  const before = performance.now() - pressed.at_ms < STATUS_MS ? pressed.ev_stops : commonEv();
  pressed = { ev_stops: before + stops, at_ms: performance.now() };
  ask({ ev_stops: pressed.ev_stops });
}

byId("lock").onclick = () => ask({ locked: !allLocked() });
byId("darker").onclick = () => addEv(-EV_STEP);
byId("brighter").onclick = () => addEv(EV_STEP);
byId("reset").onclick = () => ask({ reset: true });
byId("policies").onchange = ({ target }) => {
  target.blur(); // shows the policy in force again
  ask({ policy: target.value });
};
byId("group").onchange = ({ target }) => {
  target.blur();
  pressed.at_ms = -Infinity;
  showForce();
};

// `policies`: those to choose from; null without a token.
export function showButtons(policies, status) {
  groups = status.groups;
  const names = Object.keys(groups);
  const hidden = !policies || !status.requests;
  byId("buttons").hidden = hidden;
  byId("control").hidden = hidden || names.length < 2;
  if (hidden) return;
  offer(byId("policies"), policies);
  byId("group").hidden = names.length < 2;
  offer(byId("group"), [EVERY, ...names]);
  showForce();
}

function offer(choice, words) {
  const same = choice.length === words.length && words.every((word, place) => choice[place].value === word);
  if (!same) choice.replaceChildren(...words.map((word) => element("option", word)));
}

// What is in force for those that are meant.
function showForce() {
  const stops = commonEv();
  byId("lock").textContent = allLocked() ? "unlock" : "lock";
  byId("ev").textContent = stops === undefined ? "EV differs" : `EV ${format.signed(stops)}`;
  for (const id of ["darker", "brighter"]) byId(id).disabled = stops === undefined;
  const choice = byId("policies");
  if (document.activeElement !== choice) choice.value = common(meant().map(({ policy }) => policy)) ?? "";
}
