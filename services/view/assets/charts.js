"use strict";
// Small charts on canvases: lines over time, and stacked shares.

// The margins of a chart, in pixels.
const [CHART_LEFT, CHART_RIGHT] = [36, 10];

function canvasOf(canvas) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = "10.5px system-ui, sans-serif";
  return [context, width, height];
}

// Round steps of an axis from 0 to `high`: at most `count` of them.
function stepsTo(high, count) {
  const rough = high / count;
  const power = 10 ** Math.floor(Math.log10(rough || 1));
  const choices = [1, 2, 5, 10].map((factor) => factor * power).filter((value) => value <= high);
  const step = choices.find((value) => value >= rough) || choices[choices.length - 1] || 1;
  const steps = [];
  for (let at = 0; at <= high * 1.0001; at += step) steps.push(+at.toFixed(6));
  return steps;
}

function shortNumber(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  return size >= 100 ? value.toFixed(0) : size >= 10 ? value.toFixed(1) : value.toFixed(2);
}

// Lines over x. `series` is [{ values, color, label, fill }], null breaks a line; `limit` is a dashed line across, `mark`
// a line at an x.
function lineChart(canvas, x, series, { limit = null, high = null, unit = "", xUnit = "s", absolute = false, mark = null } = {}) {
  const [context, width, height] = canvasOf(canvas);
  if (!width || !x.length) return;
  const [left, right, top, bottom] = [CHART_LEFT, CHART_RIGHT, 8, 20];
  const [inner, tall] = [width - left - right, height - top - bottom];
  const all = series.flatMap(({ values }) => values.filter((value) => value !== null && Number.isFinite(value)));
  const most = high || Math.max(limit ? limit * 1.15 : 0, ...chunked(all), 1e-3) * 1.02;
  const [x0, x1] = [x[0], Math.max(x[x.length - 1], x[0] + 1e-6)];
  const px = (value) => left + (value - x0) / (x1 - x0) * inner;
  const py = (value) => top + tall - Math.min(value / most, 1) * tall;
  context.strokeStyle = themed("grid");
  context.fillStyle = themed("soft");
  context.lineWidth = 1;
  context.textAlign = "right";
  for (const step of stepsTo(most, Math.max(2, Math.floor(tall / 28)))) {
    context.beginPath();
    context.moveTo(left, py(step));
    context.lineTo(left + inner, py(step));
    context.stroke();
    context.fillText(String(step), left - 5, py(step) + 3.5);
  }
  context.textAlign = "center";
  const places = absolute ? x : stepsTo(x1 - x0, Math.max(2, Math.floor(inner / 90))).map((step) => x0 + step);
  for (const place of places) {
    const text = `${+(absolute ? place : place - x0).toFixed(6)} ${xUnit}`;
    if (px(place) < left + inner - 12 || absolute) context.fillText(text, Math.min(px(place), width - 16), height - 5);
  }
  for (const { values, color, dash } of series) {
    context.strokeStyle = color;
    context.lineWidth = 1.4;
    context.lineJoin = "round";
    context.setLineDash(dash || []);
    context.beginPath();
    let draws = false;
    values.forEach((value, place) => {
      if (value === null || !Number.isFinite(value)) { draws = false; return; }
      if (draws) context.lineTo(px(x[place]), py(value)); else context.moveTo(px(x[place]), py(value));
      draws = true;
    });
    context.stroke();
    context.setLineDash([]);
  }
  if (mark !== null) {
    context.fillStyle = themed("ink");
    context.fillRect(px(Math.min(Math.max(mark, x0), x1)) - 0.5, top, 1, tall);
  }
  if (limit) {
    context.strokeStyle = themed("bad");
    context.setLineDash([4, 3]);
    context.beginPath();
    context.moveTo(left, py(limit));
    context.lineTo(left + inner, py(limit));
    context.stroke();
    context.setLineDash([]);
    context.textAlign = "left";
    context.fillStyle = themed("bad");
    // The line's label stays legible on the curves.
    context.strokeStyle = themed("panel");
    context.lineWidth = 3;
    context.strokeText(`${limit} ${unit}`, left + 4, py(limit) - 4);
    context.fillText(`${limit} ${unit}`, left + 4, py(limit) - 4);
  }
}

// Math.max over any number of values.
function chunked(values) {
  let most = 0;
  for (const value of values) most = Math.max(most, value);
  return [most];
}

// Shares over x, stacked: `layers` is [{ values, color }].
function stackedChart(canvas, x, layers, { xUnit = "s" } = {}) {
  const [context, width, height] = canvasOf(canvas);
  if (!width || !x.length) return;
  const [left, right, top, bottom] = [CHART_LEFT, CHART_RIGHT, 8, 20];
  const [inner, tall] = [width - left - right, height - top - bottom];
  const totals = x.map((_, place) => layers.reduce((sum, { values }) => sum + values[place], 0));
  const most = Math.max(1, ...chunked(totals));
  const columns = Math.min(x.length, Math.floor(inner));
  context.fillStyle = themed("soft");
  context.textAlign = "right";
  for (const step of stepsTo(most, 3)) context.fillText(String(step), left - 5, top + tall - step / most * tall + 3.5);
  const [x0, x1] = [x[0], x[x.length - 1]];
  context.textAlign = "center";
  for (const step of stepsTo(x1 - x0 || 1, Math.max(2, Math.floor(inner / 90)))) {
    const at = left + step / (x1 - x0 || 1) * inner;
    if (at < left + inner - 12) context.fillText(`${step} ${xUnit}`, at, height - 5);
  }
  for (let column = 0; column < columns; column++) {
    // A column shows the tick of its group with the most fallbacks, so that no short fault disappears.
    const [begin, end] = [Math.floor(column * x.length / columns), Math.floor((column + 1) * x.length / columns)];
    let worst = begin;
    const learned = (place) => layers[0].values[place] / Math.max(totals[place], 1);
    for (let place = begin; place < end; place++) if (learned(place) < learned(worst)) worst = place;
    let base = 0;
    for (const { values, color } of layers) {
      if (!values[worst]) continue;
      const tallness = values[worst] / most * tall;
      context.fillStyle = color;
      context.fillRect(left + column * inner / columns, top + tall - base - tallness, inner / columns + 0.5, tallness);
      base += tallness;
    }
  }
}

// Bars of a histogram: `bins` is [{ from, to, count }].
function histogram(canvas, bins, { limit = null, color, unit = "ms" } = {}) {
  const [context, width, height] = canvasOf(canvas);
  if (!width || !bins.length) return;
  const [left, right, top, bottom] = [CHART_LEFT, CHART_RIGHT, 8, 20];
  const [inner, tall] = [width - left - right, height - top - bottom];
  const most = Math.max(1, ...bins.map(({ count }) => count));
  const high = bins[bins.length - 1].to;
  const px = (value) => left + value / high * inner;
  context.fillStyle = themed("soft");
  context.textAlign = "right";
  for (const step of stepsTo(most, 3)) context.fillText(String(step), left - 5, top + tall - step / most * tall + 3.5);
  context.textAlign = "center";
  for (const step of stepsTo(high, Math.max(2, Math.floor(inner / 70)))) {
    if (px(step) < left + inner - 12) context.fillText(`${step} ${unit}`, px(step), height - 5);
  }
  context.fillStyle = color || themed("accent");
  for (const { from, to, count } of bins) {
    const size = count / most * tall;
    context.fillRect(px(from) + 0.5, top + tall - size, Math.max(px(to) - px(from) - 1, 1), size);
  }
  if (limit && limit < high) {
    context.fillStyle = themed("bad");
    context.fillRect(px(limit) - 0.75, top, 1.5, tall);
  }
}

function escaped(text) {
  return String(text).replace(/[&<>"]/g, (c) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" }[c]));
}

// Follows the theme of the system; a click changes it.
function themeButton(button, changed) {
  const set = (theme) => {
    root.dataset.theme = theme;
    changed();
  };
  button.addEventListener("click", () => set(root.dataset.theme === "dark" ? "light" : "dark"));
  systemDark.addEventListener("change", () => set(systemDark.matches ? "dark" : "light"));
}
