// Numbers for people, with units.

export const micros = (us) => (us == null ? "–" : us < 1000 ? `${us.toFixed(0)} µs` : `${(us / 1000).toFixed(2)} ms`);
export const decibels = (db) => (db == null ? "–" : `${db.toFixed(1)} dB`);
export const stops = (level) => (level == null ? "–" : `${level.toFixed(2)}`);
export const signed = (change) =>
  Math.abs(change) < 0.005 ? "±0" : `${change < 0 ? "−" : "+"}${Math.abs(change).toFixed(2)}`;
export const metric = (value) => (value == null ? "–" : value.toFixed(4));
export const share = (part) => (part == null ? "–" : `${(100 * part).toFixed(part < 0.0995 ? 1 : 0)} %`);
export const millis = (ms) => (ms == null ? "–" : `${ms.toFixed(ms < 10 ? 2 : 1)} ms`);
export const count = (number) => number.toLocaleString("en").replaceAll(",", "\u202f");

// The least and the greatest value, with the unit once if it is that of both.
export function range([low, high], words) {
  const [from, to] = [words(low), words(high)];
  if (from === to) return from;
  const unit = to.match(/ .*$/)?.[0] ?? "";
  return `${unit && from.endsWith(unit) ? from.slice(0, -unit.length) : from} to ${to}`;
}

export function lasting(seconds) {
  if (seconds < 90) return `${seconds.toFixed(0)} s`;
  if (seconds < 5400) return `${(seconds / 60).toFixed(0)} min`;
  if (seconds < 172800) return `${(seconds / 3600).toFixed(1)} h`;
  return `${(seconds / 86400).toFixed(0)} days`;
}

// The time of day, with the date when that is not today's.
export function clock(unixTimeS) {
  const moment = new Date(1000 * unixTimeS);
  const today = moment.toDateString() === new Date().toDateString();
  return (today ? "" : `${moment.toLocaleDateString("en-CA")} `) + moment.toLocaleTimeString("en-GB");
}
