// Buttons that change control, on a page with a token.

import { element } from "./numbers.js";
import * as format from "./format.js";

const EV_STEP = 0.5;
const STATUS_MS = 3000;
const byId = (id) => document.getElementById(id);

let requests = null; // as in the latest status
let pressed = { ev_stops: 0, at_ms: -Infinity }; // what darker or brighter asked for: a status may not show it yet
let turn = Promise.resolve();

// One after another: the last press applies.
function ask(changes) {
  turn = turn.then(() => send(changes));
}

async function send(changes) {
  const answer = await fetch("/control", { method: "POST", body: JSON.stringify(changes) }).catch(() => null);
  byId("asked").textContent = answer ? await answer.text() : "the page's server does not answer";
  byId("asked").classList.toggle("refused", !answer?.ok);
  if (!answer?.ok || changes.reset) pressed.at_ms = -Infinity;
}

function addEv(stops) {
  const before = performance.now() - pressed.at_ms < STATUS_MS ? pressed.ev_stops : requests.ev_stops;
  pressed = { ev_stops: before + stops, at_ms: performance.now() };
  ask({ ev_stops: pressed.ev_stops });
}

byId("lock").onclick = () => ask({ locked: !requests.locked });
byId("darker").onclick = () => addEv(-EV_STEP);
byId("brighter").onclick = () => addEv(EV_STEP);
byId("reset").onclick = () => ask({ reset: true });
byId("policies").onchange = ({ target }) => {
  target.blur(); // shows the policy in force again
  ask({ policy: target.value });
};

// `policies`: those to choose from; null without a token.
export function showButtons(policies, status) {
  requests = status.requests ?? null;
  byId("buttons").hidden = !policies || !requests;
  if (byId("buttons").hidden) return;
  byId("lock").textContent = requests.locked ? "unlock" : "lock";
  byId("ev").textContent = `EV ${format.signed(requests.ev_stops)}`;
  const choice = byId("policies");
  if (choice.length !== policies.length) choice.replaceChildren(...policies.map((id) => element("option", id)));
  if (document.activeElement !== choice) choice.value = status.policy;
}
