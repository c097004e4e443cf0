"use strict";
// Two runs, A and B, on one page: what differs, a verdict, one scene with one slider, and the difference by agent.

// Number of random samples of agents for an interval, and the share of them that the interval holds.
const SAMPLES = 400;
const INTERVAL = 0.95;
// Fewer agents give no interval.
const AGENTS_LEAST = 4;
// Number of listed agents.
const COMPARED_MAX = 50;

// The facts of two runs that differ, as [name, of A, of B].
function differingFacts(a, b) {
  const facts = ({ report: { run, stgdat_version: version } }) => ({
    "build": version, "weights": run.weights, "SHA-256 of the weights": run.weights_sha256, "recording": run.recording,
    "SHA-256 of the recording": run.recording_sha256, "seed": run.seed, "speed": run.speed, "precision": run.precision,
    "retrieval": run.retrieval === null ? null : run.retrieval ? "on" : "off", "memory entries at the start": run.memory_entries,
    "limit in ticks": run.ticks_limit, "interval, ms": run.interval_ms, "lockstep": run.lockstep ? "yes" : "no",
  });
  const differing = (ofA, ofB, unset) => [...new Set([...Object.keys(ofA), ...Object.keys(ofB)])]
    .map((name) => [name, ofA[name] ?? unset, ofB[name] ?? unset]).filter(([, x, y]) => x !== y);
  return [...differing(facts(a), facts(b), "unknown"), ...(a.options && b.options ? differing(a.options, b.options, "default") : [])];
}

// The tracks of a run by identity: times in s and positions in cm.
function tracksOf(frames) {
  const tracks = new Map();
  frames.forEach(({ t, agents }) => agents.forEach(({ n, p }) => {
    if (!tracks.has(n)) tracks.set(n, { t: [], p: [] });
    tracks.get(n).t.push(t);
    tracks.get(n).p.push(p);
  }));
  return tracks;
}

// The position of a track at a time, between its samples; null outside, and in gaps of more than a second.
function placeAt({ t, p }, time) {
  let [low, high] = [0, t.length - 1];
  if (!t.length || time < t[0] - 1e-6 || time > t[high] + 1e-6) return null;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (t[middle] <= time) low = middle; else high = middle;
  }
  if (t[high] - t[low] > 1) return null;
  const share = t[high] > t[low] ? Math.min(Math.max((time - t[low]) / (t[high] - t[low]), 0), 1) : 0;
  return [0, 1].map((axis) => p[low][axis] + (p[high][axis] - p[low][axis]) * share);
}

// The mean error in m of a forecast against its own track, over the horizon; null if the track ends before.
function errorOf(track, { t }, { p, f }, step) {
  let sum = 0;
  for (let at = 0; at < f.b.length; at += 2) {
    const place = placeAt(track, t + (at / 2 + 1) * step);
    if (!place) return null;
    sum += Math.hypot(p[0] + f.b[at] - place[0], p[1] + f.b[at + 1] - place[1]);
  }
  return sum / (f.b.length / 2) / 100;
}

// The errors of both runs by agent, over the ticks and agents that both have.
function compareAgents(framesA, framesB, step) {
  const [tracksA, tracksB] = [tracksOf(framesA), tracksOf(framesB)];
  // Recordings of the same input may number ticks differently.
  const ofB = new Map(framesB.map((frame) => [frame.t, frame]));
  const found = new Map();
  framesA.forEach((frame, place) => {
    const other = ofB.get(frame.t);
    if (!other) return;
    const agents = new Map(other.agents.map((agent) => [agent.n, agent]));
    for (const agent of frame.agents) {
      const twin = agents.get(agent.n);
      if (!twin || !agent.f || !twin.f || !agent.f.b.length || !twin.f.b.length || twin.t !== agent.t) continue;
      const errors = [errorOf(tracksA.get(agent.n), frame, agent, step), errorOf(tracksB.get(agent.n), other, twin, step)];
      if (errors.includes(null)) continue;
      if (!found.has(agent.n)) found.set(agent.n, { n: agent.n, i: agent.i, t: agent.t, a: 0, b: 0, count: 0, most: -1, place: 0 });
      const sums = found.get(agent.n);
      sums.a += errors[0];
      sums.b += errors[1];
      sums.count++;
      const apart = Math.abs(errors[1] - errors[0]);
      if (apart > sums.most) [sums.most, sums.place] = [apart, place];
    }
  });
  return [...found.values()];
}

// The change of the mean error from A to B in percent, with an interval from random samples of agents.
function changeOf(agents) {
  const change = (chosen) => {
    const sum = (run) => chosen.reduce((total, agent) => total + agent[run], 0);
    return (sum("b") / Math.max(sum("a"), 1e-9) - 1) * 100;
  };
  if (agents.length < AGENTS_LEAST) return { change: agents.length ? change(agents) : null, low: null, high: null };
  let state = 1;
  const random = (below) => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return Math.floor(state / 2 ** 32 * below);
  };
  const changes = Array.from({ length: SAMPLES }, () => change(agents.map(() => agents[random(agents.length)]))).sort((a, b) => a - b);
  const cut = Math.floor(SAMPLES * (1 - INTERVAL) / 2);
  return { change: change(agents), low: changes[cut], high: changes[SAMPLES - 1 - cut] };
}

// The verdict on a type in words. An interval within 0.1 % is no difference.
function verdictOn(type, agents) {
  const { change, low, high } = changeOf(agents);
  if (change === null) return null;
  const size = (value) => Math.abs(value).toFixed(1);
  const signed = (value) => (+size(value) === 0 ? "" : value < 0 ? "−" : "+") + size(value);
  if (low === null) return `${PLURALS[type]}: ${agents.length} ${agents.length === 1 ? "agent is" : "agents are"} too few for a verdict`;
  if (Math.max(Math.abs(low), Math.abs(high)) < 0.15) return `no difference for ${PLURALS[type]}`;
  if (high < 0) return `B is better by ${size(change)} % (${size(high)} to ${size(low)}) for ${PLURALS[type]}`;
  if (low > 0) return `B is worse by ${size(change)} % (${size(low)} to ${size(high)}) for ${PLURALS[type]}`;
  return `no clear difference for ${PLURALS[type]}: ${signed(change)} % (${signed(low)} to ${signed(high)})`;
}

// The verdict on latencies; null if a run has none, or waited for its forecasts.
function verdictOnTimes(a, b) {
  if (a.report.run.lockstep || b.report.run.lockstep) return null;
  const [before, now] = [a, b].map(({ report }) => report.end_to_end_ms.p99);
  if (before === null || now === null) return null;
  const apart = now - before;
  return Math.abs(apart) < 0.5 ? "the same p99" : `p99 ${shortNumber(Math.abs(apart))} ms ${apart > 0 ? "longer" : "shorter"}`;
}

// A row of figures of both runs with their difference.
function comparedRow(name, a, b, digits) {
  if (!Number.isFinite(a) && !Number.isFinite(b)) return "";
  const text = (value) => (Number.isFinite(value) ? value.toFixed(digits) : "–");
  const size = Math.abs(b - a).toFixed(digits);
  const sign = +size === 0 ? "" : b > a ? "+" : "−";
  return `<tr><td>${name}</td><td>${text(a)}</td><td>${text(b)}</td><td>${Number.isFinite(b - a) ? sign + size : "–"}</td></tr>`;
}

// Rows of the share of agents within the regions of 90 % at the end of the horizon, by type.
function calibrationRows(a, b) {
  const [ofA, ofB] = [a, b].map(({ unpacked: { details } }) => (details ? details.errors : []));
  const last = (row) => 100 * (row.within_90[row.within_90.length - 1] ?? NaN);
  return ofA.map((row) => [row, ofB.find(({ type }) => type === row.type)]).filter(([, other]) => other)
    .map(([row, other]) => comparedRow(`${PLURALS[TYPES.indexOf(row.type)]} within the 90 % region, %`, last(row), last(other), 1));
}

function comparison([a, b]) {
  const step = ((a.unpacked.details || b.unpacked.details || { errors: [] }).errors[0] || { horizon_s: [0.4] }).horizon_s[0];
  const agents = compareAgents(a.unpacked.frames, b.unpacked.frames, step);
  const byType = TYPES.map((_, type) => agents.filter(({ t }) => t === type));
  const verdicts = [...byType.map((ofType, type) => verdictOn(type, ofType)), verdictOnTimes(a, b)].filter(Boolean);
  const facts = differingFacts(a, b);
  const mean = (list, run) => list.reduce((sum, agent) => sum + agent[run], 0) / list.reduce((sum, { count }) => sum + count, 0);
  const learned = ({ report: { forecasts: { learned, held, kinematic } } }) => 100 * learned / (learned + held + kinematic);
  const rows = [
    ...byType.map((list, type) => comparedRow(`mean error of ${PLURALS[type]}, m`, mean(list, "a"), mean(list, "b"), 3)),
    ...calibrationRows(a, b),
    comparedRow("minADE against the truth, m", a.report.accuracy.ade_m ?? NaN, b.report.accuracy.ade_m ?? NaN, 3),
    comparedRow("learned forecasts, %", learned(a), learned(b), 1),
    comparedRow("end to end p50, ms", a.report.end_to_end_ms.p50 ?? NaN, b.report.end_to_end_ms.p50 ?? NaN, 2),
    comparedRow("end to end p99, ms", a.report.end_to_end_ms.p99 ?? NaN, b.report.end_to_end_ms.p99 ?? NaN, 2),
    ...a.report.stages.map((stage) => [stage, b.report.stages.find(({ name }) => name === stage.name)]).filter(([, other]) => other)
      .map(([stage, other]) => comparedRow(`${escaped(stage.name)} compute p99, ms`, stage.compute_ms.p99 ?? NaN, other.compute_ms.p99 ?? NaN, 2)),
    comparedRow("late ticks", a.report.late_ticks, b.report.late_ticks, 0), comparedRow("lost frames", a.report.drops, b.report.drops, 0),
  ].join("");
  const largest = agents.filter(({ a, b, count }) => Math.abs(b - a) / count >= 0.005).sort((x, y) => Math.abs(y.b - y.a) / y.count - Math.abs(x.b - x.a) / x.count).slice(0, COMPARED_MAX);
  const list = largest.map(({ n, t, a, b, count, place, i }) => `<tr data-place="${place}" data-i="${i}"><td>${TYPES[t]} ${escaped(n)}</td>
    <td>${(a / count).toFixed(2)}</td><td>${(b / count).toFixed(2)}</td><td>${b > a ? "+" : "−"}${(Math.abs(b - a) / count).toFixed(2)}</td></tr>`).join("");
  const card = element(`<section id="compare">
    <section class="card" id="differs"><h2>${facts.length ? "What differs" : a.options && b.options ? "Build, weights and options are the same" : "Build and weights are the same"}
      <span class="soft">${a.options && b.options ? "" : "only recordings contain the options"}</span></h2>
      ${facts.length ? `<div class="scroll"><table><tr><th></th><th>A, ${escaped(a.name)}</th><th>B, ${escaped(b.name)}</th></tr>${facts.map(([name, x, y]) =>
        `<tr><td>${escaped(name)}</td><td>${escaped(x)}</td><td>${escaped(y)}</td></tr>`).join("")}</table></div>` : ""}</section>
    <div class="verdict" id="compared"><b>${verdicts.length ? escaped(verdicts.join("; ").replace(/^./, (first) => first.toUpperCase())) : "The runs have no agents and ticks in common"}.</b></div>
    <div class="grid"><section class="card"><h2>A is ${escaped(a.name)}, B is ${escaped(b.name)}</h2><div class="scroll"><table>
      <tr><th></th><th>A</th><th>B</th><th>difference</th></tr>${rows}</table></div>
      <p class="note">Errors are the mean over the horizon, against where the agents were tracked later. Intervals hold
      95&nbsp;% of random samples of the agents.</p></section>
    <section class="card"><h2>Largest differences<span class="soft">mean error, m; a click shows the agent</span></h2><div class="scroll tall"><table id="largest">
      <tr><th>agent</th><th>A</th><th>B</th><th>difference</th></tr>${list || "<tr><td class=soft>none</td></tr>"}</table></div></section></div>
    <div data-slot="scene"></div></section>`);
  return card;
}

// The scene of both runs: A in the colours of its causes, B dashed over it.
function comparedScene(card, [a, b]) {
  const canvas = sceneOver(card, a, a.unpacked.frames, "The scene of both runs", b.unpacked.frames);
  card.querySelector("#largest").addEventListener("click", ({ target }) => {
    const row = target.closest("tr[data-place]");
    if (!row || !canvas) return;
    canvas.selected = row.dataset.i;
    canvas.go(+row.dataset.place);
    const agent = canvas.scene.agents.find(({ i }) => i === row.dataset.i);
    if (agent) canvas.lookAt(agent.p);
    canvas.canvas.scrollIntoView({ block: "center" });
  });
}
