// Buttons that change control, on a page with a token.

import { element } from "./numbers.js";
import * as format from "./format.js";

const EV_STEP = 0.5;
const byId = (id) => document.getElementById(id);

let requests = null; // as in the latest status

async function ask(changes) {
  const answer = await fetch("/control", { method: "POST", body: JSON.stringify(changes) }).catch(() => null);
  byId("asked").textContent = answer ? await answer.text() : "the page's server does not answer";
  byId("asked").classList.toggle("refused", !answer?.ok);
}

byId("lock").onclick = () => ask({ locked: !requests.locked });
byId("darker").onclick = () => ask({ ev_stops: requests.ev_stops - EV_STEP });
byId("brighter").onclick = () => ask({ ev_stops: requests.ev_stops + EV_STEP });
byId("reset").onclick = () => ask({ reset: true });
byId("policies").onchange = ({ target }) => {
  target.blur(); // shows what applies again
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
