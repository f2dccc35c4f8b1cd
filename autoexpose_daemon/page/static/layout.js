// What depends on the rig: a picture for each camera; a decision and lanes of history for each group of cameras.

import { LANES } from "./charts.js";
import { element } from "./numbers.js";

const byId = (id) => document.getElementById(id);
const [control, buttons] = [byId("control"), byId("buttons")]; // which move
const made = (id) => byId(id).content.firstElementChild.cloneNode(true);

export const figures = new Map(); // by camera
export const cards = new Map(); // decisions, by group
export const lanes = []; // of all groups: { group, lane, canvas, value }

let shown = null;

// `groups`: names of cameras by group. `onHover` is told of a pointer on a lane, and with null of its end.
export function layOut(groups, onHover) {
  if (JSON.stringify(groups) === shown) return;
  shown = JSON.stringify(groups);
  const names = Object.keys(groups);
  const several = names.length > 1;
  for (const known of [figures, cards]) known.clear();
  lanes.length = 0;
  byId("groups").replaceChildren(...names.map((name) => blockOf(name, groups[name], several)));
  byId("groups").classList.toggle("several", several);
  (several ? control : cards.get(names[0]).querySelector(".of-buttons")).append(buttons);
  control.hidden = !several || buttons.hidden;
  const [title] = byId("history").children;
  byId("history").replaceChildren(title, ...names.flatMap((name) => lanesOf(name, several, onHover)));
}

function blockOf(group, cameras, several) {
  const block = made("a-group");
  block.dataset.group = group;
  const pictures = block.querySelector(".pictures");
  pictures.append(...cameras.map(figureOf));
  pictures.classList.toggle("alone", cameras.length === 1);
  const card = block.querySelector(".decision");
  card.querySelector("h2 span").textContent = several ? `Decision for ${group}` : "Decision";
  card.querySelector(".curve-title").textContent = `Predicted metric of the ${cameras[0]} picture`;
  cards.set(group, card);
  return block;
}

function figureOf(camera) {
  const figure = made("a-picture");
  figure.dataset.camera = camera;
  figure.querySelector("figcaption").append(element("h2", camera));
  figures.set(camera, figure);
  return figure;
}

function lanesOf(group, several, onHover) {
  const box = element("div", undefined, several ? "lanes beside" : "lanes");
  for (const lane of LANES) {
    const heading = element("h3");
    const value = element("b");
    heading.append(element("span", lane.name), value);
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
