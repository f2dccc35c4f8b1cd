// What depends on the rig: a picture for each camera, a decision and lanes of history for each group of cameras.

import { LANES } from "./charts.js";
import { element } from "./numbers.js";

const byId = (id) => document.getElementById(id);
const [control, buttons] = [byId("control"), byId("buttons")]; // which move with their cards
const made = (id) => byId(id).content.firstElementChild.cloneNode(true);

export const figures = new Map(); // by camera
export const cards = new Map(); // by group
export const lanes = []; // of all groups: { group, lane, canvas, value }

let shown = null;

// `groups`: names of cameras by group. `onHover` is told of a pointer on a lane, and with null of its end.
export function layOut(cameras, groups, onHover) {
  const wanted = JSON.stringify([cameras, groups]);
  if (wanted === shown) return;
  shown = wanted;
  const names = Object.keys(groups);
  fillMap(figures, cameras, figureOf);
  byId("pictures").replaceChildren(...figures.values());
  byId("pictures").classList.toggle("alone", cameras.length === 1);
  fillMap(cards, names, (name) => cardOf(name, groups[name], names.length > 1));
  byId("decisions").replaceChildren(control, ...cards.values());
  const [first] = cards.values();
  (names.length > 1 ? control : first.querySelector(".of-buttons")).append(buttons);
  control.hidden = names.length < 2 || buttons.hidden;
  const [title] = byId("history").children;
  lanes.length = 0;
  byId("history").replaceChildren(title, ...names.flatMap((name) => lanesOf(name, names.length > 1, onHover)));
}

function fillMap(map, keys, make) {
  map.clear();
  for (const key of keys) map.set(key, make(key));
}

function figureOf(camera) {
  const figure = made("a-picture");
  figure.dataset.camera = camera;
  figure.querySelector("figcaption").append(element("h2", camera));
  return figure;
}

function cardOf(group, [first], several) {
  const card = made("a-decision");
  card.dataset.group = group;
  card.querySelector("h2 span").textContent = several ? `Decision for ${group}` : "Decision";
  card.querySelector(".curve-title").textContent = `Predicted metric of the ${first} picture`;
  return card;
}

function lanesOf(group, several, onHover) {
  const box = element("div", undefined, several ? "lanes beside" : "lanes");
  for (const lane of LANES) {
    const heading = element("h3", lane.name);
    const value = element("b");
    heading.append(value);
    const canvas = element("canvas");
    const place = element("div", undefined, "lane");
    place.append(heading, canvas);
    box.append(place);
    canvas.addEventListener("pointermove", (event) => onHover(canvas, event.offsetX));
    canvas.addEventListener("pointerleave", () => onHover(canvas, null));
    lanes.push({ group, lane, canvas, value });
  }
  return several ? [element("h3", group), box] : [box];
}
