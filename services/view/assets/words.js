"use strict";
// The words and looks of both pages: names, colours, dashes, shapes, and why a forecast is as it is. The numbers' names
// and the looks of causes come from the program: TYPES, QUALITIES, EXPERTS and LOOKS.

const PLURALS = ["vehicles", "cyclists", "pedestrians"];
const VERDICTS = { ok: ["OK", "good"], doubtful: ["DOUBTFUL", "warn"], degraded: ["DEGRADED", "bad"], empty: ["EMPTY", "warn"] };

const root = document.documentElement;
const systemDark = matchMedia("(prefers-color-scheme: dark)");
root.dataset.theme = systemDark.matches ? "dark" : "light";

// The value of a style variable, so that canvases follow the theme.
function themed(name) {
  return getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
}

function palette() {
  const colors = {};
  for (const name of ["ground", "grid", "ink", "soft", "faint", "lane", "ego", "select", "unknown", "bad"]) {
    colors[name] = themed(name);
  }
  colors.cause = LOOKS.map(({ cause }) => themed("cause-" + cause));
  return colors;
}

function colorOf(colors, forecast) {
  return forecast ? colors.cause[forecast.c] || colors.unknown : colors.unknown;
}

// The shapes of the vocabulary, about 8 pixels wide.
const SHAPES = {
  disc: "M-3 0A3 3 0 1 0 3 0A3 3 0 1 0-3 0Z", square: "M-3-3H3V3H-3Z", ring: "M-3.2 0A3.2 3.2 0 1 0 3.2 0A3.2 3.2 0 1 0-3.2 0Z",
  triangle: "M0-4L4 3H-4Z", cross: "M-3.4-3.4L3.4 3.4M3.4-3.4L-3.4 3.4", diamond: "M0-4.4L4.4 0L0 4.4L-4.4 0Z",
  plus: "M-4 0H4M0-4V4",
};
const OPEN_SHAPES = ["ring", "cross", "plus"];

// A cause in words. A newer version's cause is a number.
function causeWords(cause) {
  return LOOKS[cause] ? LOOKS[cause].words : `cause ${cause}`;
}

// A cause in words, by its name.
function wordsOf(name) {
  const look = LOOKS.find(({ cause }) => cause === name);
  return look ? look.words : name;
}

// A cause as a line with its dash and shape, or its shape alone.
function glyphOf(cause, isShort = false) {
  const look = LOOKS[cause] || { cause: "unknown", dash: [], shape: "disc" };
  const color = LOOKS[cause] ? `var(--cause-${look.cause})` : "var(--unknown)";
  const fill = OPEN_SHAPES.includes(look.shape) ? "none" : color;
  return `<svg width="${isShort ? 12 : 34}" height="12" viewBox="${isShort ? "22 0 12 12" : "0 0 34 12"}" aria-hidden="true"><g stroke="${color}" stroke-width="2"><path d="${isShort ? "" : "M0 6H26"}" ` +
    `stroke-dasharray="${look.dash.join(" ")}" fill="none"/><path d="${SHAPES[look.shape]}" transform="translate(28 6)" fill="${fill}"/></g></svg>`;
}

// The legend: what colours, dashes and shapes mean, for the causes that occur.
function legendOf(causes, extra = "") {
  const items = causes.map((cause) => `<span class="key" title="${LOOKS[cause] ? explanationOf(cause, 0) : ""}">${glyphOf(cause)}` +
    `${causeWords(cause)}</span>`);
  return items.join("") + extra;
}

// Why a forecast is as it is, for agents of a type. `steady` is the weight of constant velocity in thousandths.
function explanationOf(cause, type, steady = 0) {
  if (!LOOKS[cause]) return `Cause ${cause} of a newer version`;
  const share = steady ? ` (${(steady / 10).toFixed(0)} %)` : "";
  return LOOKS[cause].explanation.replace("{agents}", PLURALS[type] || "agents").replace("{share}", share);
}

// The name of the expert in a slot of the weights.
function expertOf(slot, type) {
  return EXPERTS[slot] ? EXPERTS[slot][type] : `expert ${slot}`;
}
