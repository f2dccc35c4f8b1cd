// The page's tables and texts, from the daemon's status. Text only: names come from outside.

import * as format from "./format.js";

const byId = (id) => document.getElementById(id);

export function element(name, text, kind) {
  const made = document.createElement(name);
  if (text !== undefined) made.textContent = text;
  if (kind) made.className = kind;
  return made;
}

// A definition list from [title, text, class of the text].
export function define(list, entries) {
  list.replaceChildren(
    ...entries.map(([title, text, kind]) => {
      const pair = element("div");
      pair.append(element("dt", title), " ", element("dd", text, kind));
      return pair;
    }),
  );
}

// A table from rows, each of texts and a kind: "bad", "none" or neither.
function fill(table, rows, head) {
  const lines = rows.map(([cells, kind]) => {
    const line = element("tr", undefined, kind);
    line.append(...cells.map((cell) => element("td", cell)));
    return line;
  });
  if (head) {
    const line = element("tr");
    line.append(...head.map((title) => element("th", title)));
    lines.unshift(line);
  }
  table.replaceChildren(...lines);
}

const byReason = (counts) => Object.entries(counts).filter(([, number]) => number > 0);
const words = (name) => name.replaceAll("_", " ");

export function showStatus(status, tables) {
  define(byId("headline"), [
    ["rig", status.rig],
    ["pairs/s", status.rate_hz.toFixed(1)],
    ["up", format.lasting(status.uptime_s)],
    ...(Object.keys(status.groups).length > 1 && status.tracking?.age_s != null
      ? [["steered by", status.tracking.by.join(" and ")]]
      : []),
  ]);
  showCounts(byId("triggers"), tables.triggers);
  showCounts(byId("writes"), tables.writes);
  showLatency(tables.latency);
  showCameras(status);
  showConsumers(status.publishing);
  showRecorder(status.recorder);
  showFaults(status.faults);
}

// Who decides for a group, and what stands above that, in words.
export function policyWords(group, tracking) {
  return [`by ${group.policy}`, ...requested(group.requests), ...steered(tracking)].join(", ");
}

// What was requested of control while it runs, in words.
function requested(requests) {
  const { locked, ev_stops: stops } = requests;
  return [
    ...(locked ? [`locked at ${format.micros(locked.exposure_time_us)}, ${format.decibels(locked.gain_db)}`] : []),
    ...(stops ? [`EV ${format.signed(stops)}`] : []),
    ...requests.changed.map((name) => `${name} changed`),
  ];
}

// Which consumers steer, in words.
function steered(tracking) {
  if (tracking?.age_s == null) return [];
  return [`steered by ${tracking.by.join(" and ")}, age ${tracking.age_s.toFixed(1)} s`];
}

export function showDecision(card, decision) {
  const none = "none: control skipped this pair for a newer one";
  card.querySelector(".reason").textContent = decision ? decision.reason : none;
  const values = card.querySelector(".values");
  if (!decision) return define(values, []);
  define(values, [
    ["next", `${format.micros(decision.exposure_time_us)}, ${format.decibels(decision.gain_db)}`],
    ["level", `${format.stops(decision.level)} stops`],
    ...(decision.metric === null ? [] : [["metric", format.metric(decision.metric)]]),
    ["saturated", format.share(decision.saturated_share), "saturated"],
    ["black", format.share(decision.black_share), "black"],
    ["motion", decision.motion_px === null ? "–" : `${decision.motion_px.toFixed(1)} px`],
  ]);
}

// Rows of a label, a count, and whether the count should be 0.
function showCounts(table, rows) {
  fill(
    table,
    rows.map(([label, number, anomaly]) => [[label, format.count(number)], number === 0 ? "none" : anomaly && "bad"]),
  );
}

// Rows of a label, a median and a 99th percentile.
function showLatency(rows) {
  fill(
    byId("latency"),
    rows.map(([label, p50, p99]) => [[label, format.millis(p50), format.millis(p99)]]),
    ["", "median", "99 of 100"],
  );
}

function showCameras({ cameras, groups }) {
  const groupOf = (name) => Object.keys(groups).find((group) => groups[group].cameras.includes(name));
  const several = Object.keys(groups).length > 1;
  const rows = Object.entries(cameras).flatMap(([name, camera]) => [
    [[name, camera.camera ?? "gone"], camera.camera === null && "bad"],
    ...(several ? [[["  group", groupOf(name) ?? "–"], "none"]] : []),
    ...(Object.keys(cameras).length > 2 ? [[["  lost", format.count(camera.lost)], "none"]] : []),
    [["  response", responseWords(camera)], camera.misfit === null ? "none" : "bad"],
    ...(camera.ptp ? [[["  PTP", ptpWords(camera.ptp)], "none"]] : []),
  ]);
  fill(byId("cameras"), rows);
}

function ptpWords({ status, offset_ns: offset }) {
  return offset === null ? status : `${status}, ${(offset / 1000).toFixed(1)} us off`;
}

function responseWords({ drift_grey: drift, misfit }) {
  if (misfit !== null) return misfit;
  return drift === null ? "not tested yet" : `off by ${drift.toFixed(1)} grey levels`;
}

function showConsumers(publishing) {
  const rows = Object.entries(publishing?.consumers ?? {}).map(([name, tally]) => [
    [name, format.count(tally.pairs), format.count(tally.lost), format.count(tally.too_slow)],
    tally.lost + tally.too_slow > 0 && "bad",
  ]);
  const unlisted = publishing?.unlisted_consumers ?? 0;
  if (unlisted > 0) rows.push([[`${format.count(unlisted)} more`]]);
  fill(byId("consumers"), rows, ["", "pairs", "lost", "too slow"]);
  if (!publishing) return;
  const dropped = byReason(publishing.dropped).map(([reason, number]) => `${format.count(number)} ${words(reason)}`);
  byId("published").textContent =
    publishing.trouble || `${format.count(publishing.sent)} pairs sent; dropped: ${dropped.join(", ") || "none"}`;
}

function showRecorder(recorder) {
  if (!recorder) return fill(byId("recorder"), [[["not recording"], "none"]]);
  const rows = [
    [["steps", format.count(recorder.steps)]],
    [["dropped", format.count(recorder.dropped)], recorder.dropped > 0 ? "bad" : "none"],
  ];
  if (recorder.failure) rows.push([["ended", recorder.failure], "bad"]);
  return fill(byId("recorder"), rows);
}

// The latest first; repeated messages share a line.
function showFaults(faults) {
  const known = new Map();
  for (const fault of [...faults].reverse()) {
    const line = known.get(fault.message);
    if (line) line.times += 1;
    else known.set(fault.message, { ...fault, times: 1 });
  }
  const lines = [...known.values()].map((fault) => {
    const line = element("li", undefined, fault.level);
    const text = element("span", fault.message);
    if (fault.times > 1) text.append(" ", element("small", `${fault.times} times`));
    line.append(element("time", format.clock(fault.unix_time_s)), text);
    return line;
  });
  byId("fault-lines").replaceChildren(...(lines.length ? lines : [element("p", "none", "quiet")]));
}
