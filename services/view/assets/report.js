"use strict";
// The report page: builds a column for each run from RUNS, and unpacks what the runs recorded.

function bytesOf(base64) {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let at = 0; at < text.length; at++) bytes[at] = text.charCodeAt(at);
  return bytes;
}

async function inflate(base64) {
  const stream = new Blob([bytesOf(base64)]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// The scenes of the kept ticks.
function decodeScrub(bytes) {
  const head = new Varints(bytes, 0, bytes.length);
  const [tracksLen, ticksLen] = [head.next(), head.next()];
  const lengths = Array.from({ length: 5 }, () => head.next());
  let at = head.at;
  const [tracks, ticks, agents, poses, steps] = lengths.map((length) => {
    const stream = new Varints(bytes, at, at + length);
    at += length;
    return stream;
  });
  const known = Array.from({ length: tracksLen }, () => ({
    i: tracks.text(), n: tracks.text(), t: tracks.next(), s: [tracks.next(), tracks.next()], pose: [0, 0, 0],
  }));
  const scenes = [];
  let [seq, stamp] = [0, 0];
  for (let tick = 0; tick < ticksLen; tick++) {
    seq += ticks.next();
    stamp += ticks.next();
    const scene = { seq, t: stamp / 1000, ego: null, agents: [] };
    let place = 0;
    for (let left = ticks.next(); left > 0; left--) {
      place += agents.next();
      const kind = agents.next();
      const track = known[place];
      track.pose = track.pose.map((value) => value + poses.next());
      const agent = { i: track.i, n: track.n, t: track.t, s: track.s, u: 0, y: [], v: [0, 0],
                      p: [track.pose[0], track.pose[1]], h: track.pose[2] };
      if (kind >= 0) {
        agent.f = { q: kind % 4, c: Math.floor(kind / 4), a: 0, b: steps.path(), m: [], e: [], x: [], o: 0 };
      }
      scene.agents.push(agent);
    }
    scenes.push(scene);
  }
  return scenes;
}

const percent = (share) => (share === null || share === undefined ? "–" : `${(share * 100).toFixed(share > 0.1 ? 0 : 1)} %`);

function element(html) {
  const template = document.createElement("template");
  template.innerHTML = html.trim();
  return template.content.firstElementChild;
}

function figures(list) {
  return `<div class="figures">${list.filter(Boolean).map(([value, name, tone]) =>
    `<div class="figure"><b class="${tone || ""}">${value}</b><span>${name}</span></div>`).join("")}</div>`;
}

function headOf(run) {
  const { report } = run;
  const [word, tone] = VERDICTS[report.verdict.status] || [report.verdict.status, "soft"];
  const isLockstep = report.run.lockstep;
  const ok = `every tick ${isLockstep ? "forecast" : "in time"}, nothing lost`;
  const reasons = report.verdict.reasons.length ? report.verdict.reasons : [ok];
  const doubts = (report.input.findings || []).map((finding) => finding.text || "").filter(Boolean);
  const facts = [`${report.ticks.toLocaleString("en")} ticks`,
    report.run.played_s && `${report.run.played_s.toFixed(1)} s`,
    report.agents.mean && `${report.agents.mean.toFixed(1)} agents per tick`,
    isLockstep ? "in lockstep" : "in real time"].filter(Boolean);
  return `<header><h2>${escaped(report.run.recording || run.name).replace(/[/_]/g, "$&<wbr>")}</h2>
    <p class="soft">${escaped(run.name)} · ${facts.join(" · ")}</p></header>
    <div class="verdict ${tone}"><b>${word}</b><ul class="plain">${[...reasons, ...doubts].map((reason) =>
      `<li>${escaped(reason)}</li>`).join("")}</ul></div>`;
}

function figuresOf({ report }) {
  const { end_to_end_ms: time, late_limit_ms: limit, accuracy, forecasts } = report;
  const total = forecasts.learned + forecasts.held + forecasts.kinematic;
  const over = (value) => (limit && !report.run.lockstep && value > limit ? "bad" : "");
  const zero = (value) => (value ? "bad" : "good");
  const restarts = report.stages.reduce((sum, stage) => sum + stage.restarts, 0);
  // Frames of `predict` have no latencies.
  const times = time.p50 === null ? [] : [
    [shortNumber(time.p50), "end to end p50, ms", over(time.p50)],
    [shortNumber(time.p99), "p99, ms", over(time.p99)],
    [shortNumber(time.max), "max, ms", over(time.max)],
    report.run.lockstep ? [report.late_ticks, `ticks over ${shortNumber(limit)} ms`] : [report.late_ticks, "late ticks", zero(report.late_ticks)],
  ];
  return `<section class="card">${figures([
    ...times,
    [report.drops, "lost frames", zero(report.drops)],
    [restarts, "restarts", zero(restarts)],
    total > 0 && [percent(forecasts.learned / total), "of forecasts learned"],
    accuracy.ade_m !== null && [shortNumber(accuracy.ade_m), `minADE, m (constant velocity ${shortNumber(accuracy.cv_ade_m)})`],
    accuracy.held_90 !== null && accuracy.held_90 !== undefined && [percent(accuracy.held_90), "within the 90 % region"],
  ])}</section>`;
}

function stageTable({ report }) {
  if (!report.stages.length) return "";
  const row = (stage) => {
    const over = stage.budget_ms && stage.compute_ms.p99 > stage.budget_ms;
    const share = (value) => Math.min(100 * (value || 0) / (stage.budget_ms || Infinity), 100).toFixed(1);
    const bar = stage.budget_ms ? `<div class="bar${over ? " over" : ""}"><b style="width:${share(stage.compute_ms.p99)}%"></b>` +
      `<b style="width:${share(stage.compute_ms.p50)}%"></b></div>` : "";
    const drops = stage.drops.gap + stage.drops.refused + stage.drops.restart;
    return `<tr><td>${escaped(stage.name)}</td><td>${bar}</td><td>${shortNumber(stage.compute_ms.p50)}</td>
      <td class="${over ? "bad" : ""}">${shortNumber(stage.compute_ms.p99)}</td><td>${shortNumber(stage.compute_ms.max)}</td>
      <td class="soft">${shortNumber(stage.budget_ms)}</td><td>${shortNumber(stage.waiting_ms.p99)}</td>
      <td>${shortNumber(stage.wake_up_ms.p99)}</td><td>${stage.late_ticks}</td><td>${drops}</td><td>${stage.restarts}</td></tr>`;
  };
  return `<section class="card"><h2>Stages against their budgets<span class="soft">compute, ms</span></h2>
    <div class="scroll"><table><tr><th>stage</th><th></th><th>p50</th><th>p99</th><th>max</th><th>budget</th>
    <th>waiting p99</th><th>wake-up p99</th><th>over</th><th>lost</th><th>restarts</th></tr>
    ${report.stages.map(row).join("")}</table></div></section>`;
}

function graphCard({ report }) {
  return graphOf(report, 900) && `<section class="card"><h2>Pipeline<span class="soft">p50 / p99, ms; dashed: for the next tick</span></h2>
    <div data-graph></div></section>`;
}

function accuracyTable({ report }) {
  const { accuracy } = report;
  const groups = [["all", accuracy], ...Object.entries(accuracy.by_type)].filter(([, errors]) => errors.forecasts > 0);
  if (!groups.length) return "";
  const pair = (ours, steady) => `<td>${shortNumber(ours)}</td><td class="soft">${shortNumber(steady)}</td>`;
  return `<section class="card"><h2>Accuracy against the truth<span class="soft">horizon ${shortNumber(accuracy.horizon_s)} s,
    K = ${accuracy.draws ?? "–"}</span></h2><div class="scroll"><table><tr><th>type</th><th>forecasts</th><th>minADE, m</th><th>minFDE, m</th>
    <th>ADE, K = 1</th><th class="soft">const. vel.</th><th>FDE, K = 1</th><th class="soft">const. vel.</th>
    <th>missed</th><th class="soft">const. vel.</th><th>in 50 %</th><th>in 90 %</th></tr>
    ${groups.map(([name, errors]) => `<tr><td>${escaped(name)}</td><td>${errors.forecasts.toLocaleString("en")}</td>
      <td>${shortNumber(errors.ade_m)}</td><td>${shortNumber(errors.fde_m)}</td>${pair(errors.single_ade_m, errors.cv_ade_m)}
      ${pair(errors.single_fde_m, errors.cv_fde_m)}<td>${percent(errors.miss_rate)}</td>
      <td class="soft">${percent(errors.cv_miss_rate)}</td><td>${percent(errors.held_50)}</td>
      <td>${percent(errors.held_90)}</td></tr>`).join("")}</table></div>
    <p class="note">missed: no mode ends within ${shortNumber(accuracy.miss_radius_m)} m of the truth.</p></section>`;
}

function factsOf({ report }) {
  const { run, forecasts } = report;
  const causes = Object.entries(forecasts.causes).filter(([, count]) => count).map(([cause, count]) => `${wordsOf(cause)} ${count.toLocaleString("en")}`);
  const rows = [["recording", run.recording], ["SHA-256", run.recording_sha256], ["weights", run.weights],
    ["weights SHA-256", run.weights_sha256], ["seed", run.seed], ["speed", run.speed],
    ["interval", run.interval_ms && `${run.interval_ms} ms`], ["retrieval", run.retrieval === null ? null : run.retrieval ? "on" : "off"],
    ["forecasts", `${forecasts.learned.toLocaleString("en")} learned, ${forecasts.held.toLocaleString("en")} held, ${forecasts.kinematic.toLocaleString("en")} kinematic`],
    ["causes", causes.join(", ")], ["stgdat", report.stgdat_version]];
  return `<section class="card"><h2>Facts of the run</h2><dl>${rows.filter(([, value]) => value !== null && value !== undefined && value !== "")
    .map(([name, value]) => `<dt>${name}</dt><dd>${escaped(value)}</dd>`).join("")}</dl></section>`;
}

function worstOf({ report }, details) {
  const isKnown = (tick) => tick.end_to_end_ms !== null || tick.ticks_lost > 0;
  const worst = report.worst_ticks.slice(0, 6).filter(isKnown);
  if (!worst.length) return "";
  const card = (tick) => {
    const has = details && details.worst[tick.tick] && details.worst[tick.tick].agents.length;
    const time = tick.end_to_end_ms === null ? `${tick.ticks_lost} ${tick.ticks_lost === 1 ? "tick" : "ticks"} without forecasts` : `${shortNumber(tick.end_to_end_ms)} ms`;
    return `<figure>${has ? `<canvas data-tick="${tick.tick}"></canvas>` : ""}<figcaption><b>tick ${tick.tick}</b>
      <span class="soft">· ${time} · ${tick.agents} agents</span><br>${escaped(tick.cause)}</figcaption></figure>`;
  };
  return `<section class="card"><h2>Worst ticks</h2><div class="worst">${worst.map(card).join("")}</div></section>`;
}

// How long a path of laterOf is, s: the usual horizon.
const LATER_S = 4.8;

const later = []; // what draws charts, after each change of size or theme
const scenes = [];

function chart(root, selector, draw) {
  const canvas = root.querySelector(selector);
  if (canvas) later.push(() => draw(canvas));
}

function timeCharts(column, run, details) {
  const { series } = details;
  const begin = series.t[0] || 0;
  const x = series.t.map((t) => t - begin);
  const limit = run.report.late_limit_ms;
  const budgets = Object.fromEntries(run.report.stages.map((stage) => [stage.name, stage.budget_ms]));
  const shown = series.stages.filter(([, times]) => times.some((time) => time !== null));
  const bins = series.histogram.map((count, from) => ({ from, to: from + 1, count }));
  const last = series.histogram.findLastIndex((count) => count > 0);
  const fill = (slot, isFilled, html) => {
    const place = column.querySelector(`[data-slot=${slot}]`);
    if (isFilled) place.replaceWith(element(html)); else place.remove();
  };
  fill("times", last >= 0, `<div class="grid">
    <section class="card"><h2>End to end over time<span class="soft">ms</span></h2><canvas class="chart" data-chart="time"></canvas></section>
    <section class="card"><h2>Distribution<span class="soft">ticks by end-to-end ms</span></h2><canvas class="chart" data-chart="bins"></canvas></section></div>`);
  fill("stages", shown.length > 0, `<section class="card"><h2>Compute of each stage over time
    <span class="soft">ms, dashed: budget</span></h2><div class="stages">${shown.map(([name, times], place) =>
      `<figure><figcaption><b>${name}</b></figcaption><canvas data-stage="${place}"></canvas></figure>`).join("")}</div>
    ${series.ticks_per_point > 1 ? `<p class="note">Each point is the slowest of ${series.ticks_per_point} ticks.</p>` : ""}</section>`);
  chart(column, "[data-chart=time]", (canvas) => lineChart(canvas, x,
    [{ values: series.end_to_end, color: themed("accent") }], { limit: run.report.run.lockstep ? null : limit, unit: "ms" }));
  chart(column, "[data-chart=bins]", (canvas) =>
    histogram(canvas, bins.slice(0, Math.max(last + 2, 10)), { limit: run.report.run.lockstep ? null : limit }));
  shown.forEach(([name, times], place) => chart(column, `[data-stage="${place}"]`, (canvas) =>
    lineChart(canvas, x, [{ values: times, color: themed("accent") }], { limit: budgets[name], unit: "ms" })));
  const occurring = series.causes.map((counts, cause) => [cause, counts]).filter(([cause, counts]) => cause === 0 || counts.some(Boolean));
  column.querySelector("[data-slot=quality]").replaceWith(element(`<section class="card"><h2>Forecasts by quality and cause over time
    <span class="soft">agents</span></h2><canvas class="chart" data-chart="quality"></canvas>
    <div class="legend">${legendOf(occurring.map(([cause]) => cause))}</div></section>`));
  chart(column, "[data-chart=quality]", (canvas) => stackedChart(canvas, x, occurring.map(([cause, values]) =>
    ({ values, color: themed("cause-" + LOOKS[cause].cause) }))));
}

function horizonCharts(column, details) {
  const slot = column.querySelector("[data-slot=horizon]");
  if (!details.errors.length) return slot.remove();
  // Not the colours of causes.
  const colors = { vehicle: "ink", cyclist: "warn", pedestrian: "select" };
  const keys = details.errors.map(({ type }) => `<span class="key"><i class="line" style="background:var(--${colors[type]})"></i>${type}</span>`).join("");
  slot.replaceWith(element(`<section class="card"><h2>Accuracy and calibration by horizon<span class="soft">against where agents were tracked later</span></h2>
    <div class="grid"><div><p class="note">Mean error of the best forecast, m; dashed: constant velocity</p><canvas class="chart" data-chart="errors"></canvas></div>
    <div><p class="note">Share of agents within the regions of 50 % and 90 %</p><canvas class="chart" data-chart="regions"></canvas></div></div>
    <div class="legend">${keys}</div>
    <div class="scroll"><table><tr><th>type</th><th>horizon, s</th><th>forecasts</th><th>error, m</th><th>const. vel., m</th><th>in 50 %</th><th>in 90 %</th></tr>
    ${details.errors.flatMap((row) => row.horizon_s.map((s, k) => (k + 1) % 3 ? "" : `<tr><td>${row.type}</td><td>${s.toFixed(1)}</td>
      <td>${row.forecasts[k].toLocaleString("en")}</td><td>${shortNumber(row.error_m[k])}</td><td class="soft">${shortNumber(row.constant_velocity_m[k])}</td>
      <td>${percent(row.within_50[k])}</td><td>${percent(row.within_90[k])}</td></tr>`)).join("")}</table></div></section>`));
  const longest = details.errors.reduce((a, b) => (a.horizon_s.length >= b.horizon_s.length ? a : b)).horizon_s;
  const zero = (values) => [0, ...values];
  chart(column, "[data-chart=errors]", (canvas) => lineChart(canvas, zero(longest), details.errors.flatMap((row) => [
    { values: zero(row.constant_velocity_m), color: themed(colors[row.type]), dash: [4, 3] },
    { values: zero(row.error_m), color: themed(colors[row.type]) }])));
  const places = longest.map((_, k) => k).filter((k) => (k + 1) % 3 === 0);
  chart(column, "[data-chart=regions]", (canvas) => lineChart(canvas, places.map((k) => longest[k]), [
    ...[50, 90].map((level) => ({ values: places.map(() => level), color: themed("faint"), dash: [2, 3] })),
    ...details.errors.flatMap((row) => [row.within_50, row.within_90].map((shares) => ({
      values: places.map((k) => (shares[k] === null || shares[k] === undefined ? null : shares[k] * 100)), color: themed(colors[row.type]) })))],
  { high: 100, absolute: true }));
}

// The scene of a run with a slider, or of two runs with the forecasts of both.
function sceneOver(column, run, frames, title = "The scene over the whole run", framesB = null) {
  const slot = column.querySelector("[data-slot=scene]");
  if (!frames.length) return void slot.remove();
  const note = run.every > 1 ? `One tick in ${run.every} is kept.` : "";
  const card = element(`<section class="card"><h2>${title}<span class="soft">${note}</span></h2>
    <div class="play"><button data-play>Play</button><button data-truth aria-pressed="false">Where they went</button><input type="range" min="0" max="${frames.length - 1}" value="0" aria-label="Tick">
    <output></output></div><canvas class="scene" tabindex="0"></canvas><div class="legend"></div></section>`);
  slot.replaceWith(card);
  const canvas = new SceneCanvas(card.querySelector("canvas"), { regions: false });
  scenes.push(canvas);
  canvas.lanes = run.lanes || [];
  const [input, output, button, truth] = ["input", "output", "[data-play]", "[data-truth]"].map((selector) => card.querySelector(selector));
  const causes = new Set([0]);
  for (const frame of frames) {
    for (const agent of frame.agents) {
      canvas.places.add(agent);
      if (agent.f) causes.add(agent.f.c);
    }
  }
  const begin = frames[0].t;
  const ofB = framesB && new Map(framesB.map((frame) => [frame.t, frame]));
  const show = () => {
    const frame = frames[+input.value];
    canvas.scene = frame;
    canvas.later = truth.getAttribute("aria-pressed") === "true" ? laterOf(frames, +input.value) : null;
    const other = ofB && ofB.get(frame.t);
    canvas.past = (other ? other.agents : []).filter(({ f }) => f && f.b.length).map(({ p, f }) => ({ age: 2, p, f }));
    canvas.request();
    output.textContent = `tick ${frame.seq} · ${(frame.t - begin).toFixed(1)} s · ${frame.agents.length} agents`;
  };
  card.querySelector(".legend").innerHTML = legendOf([...causes].sort(), '<span class="key"><i class="dash"></i>held</span>' +
    '<span class="key"><i class="dots"></i>kinematic</span><span class="key"><i style="background:var(--faint)"></i>places seen</span>' +
    (canvas.lanes.length ? '<span class="key"><i class="line" style="background:var(--lane)"></i>lanes</span>' : "") +
    '<span class="key"><i class="line" style="background:var(--ink)"></i>where they went</span>' +
    (framesB ? '<span class="key"><i class="line" style="background:var(--select)"></i>B, dashed</span>' : ""));
  input.addEventListener("input", show);
  canvas.go = (place) => {
    input.value = place;
    show();
  };
  truth.addEventListener("click", () => {
    truth.setAttribute("aria-pressed", String(truth.getAttribute("aria-pressed") === "false"));
    show();
  });
  let playing = null;
  button.addEventListener("click", () => {
    if (playing) { clearInterval(playing); playing = null; button.textContent = "Play"; return; }
    if (+input.value >= frames.length - 1) input.value = 0;
    button.textContent = "Stop";
    const step = Math.max((frames[frames.length - 1].t - begin) / Math.max(frames.length - 1, 1), 0.02);
    playing = setInterval(() => {
      if (+input.value >= frames.length - 1) return button.click();
      input.value = +input.value + 1;
      show();
    }, step * 1000);
  });
  input.value = Math.floor(frames.length / 2);
  show();
  return canvas;
}

// Where the agents of a frame were tracked later, for the length of a forecast.
function laterOf(frames, place) {
  const paths = new Map(frames[place].agents.map(({ i, p }) => [i, [...p]]));
  for (const { t, agents } of frames.slice(place + 1)) {
    if (t > frames[place].t + LATER_S) break;
    for (const { i, p } of agents) if (paths.has(i)) paths.get(i).push(...p);
  }
  return paths;
}

function worstScenes(column, run, details) {
  for (const canvas of column.querySelectorAll("[data-tick]")) {
    const scene = new SceneCanvas(canvas, { interactive: false });
    scenes.push(scene);
    scene.lanes = run.lanes || [];
    scene.show(details.worst[canvas.dataset.tick]);
  }
}

function redraw() {
  for (const draw of later) draw();
  for (const scene of scenes) scene.theme();
}

async function build() {
  document.body.classList.toggle("two", RUNS.length > 1);
  document.title = `${RUNS.map((run) => run.report.run.recording || run.name).join(" · ")} · stgdat report`;
  for (const run of RUNS) {
    const details = run.details ? JSON.parse(new TextDecoder().decode(await inflate(run.details))) : null;
    const frames = run.scrub ? decodeScrub(await inflate(run.scrub)) : [];
    const column = element(`<article class="run">${headOf(run)}${figuresOf(run)}
      ${details && RUNS.length === 1 ? '<div data-slot="scene"></div>' : ""}${details ? '<div data-slot="times"></div><div data-slot="stages"></div>' : ""}
      ${graphCard(run)}${stageTable(run)}${worstOf(run, details)}${details ? '<div data-slot="quality"></div>' : ""}
      ${accuracyTable(run)}${details ? '<div data-slot="horizon"></div>' : ""}${factsOf(run)}</article>`);
    document.getElementById("runs").append(column);
    const graph = column.querySelector("[data-graph]");
    if (graph) later.push(() => { graph.innerHTML = graphOf(run.report, graph.clientWidth); });
    if (details) {
      timeCharts(column, run, details);
      horizonCharts(column, details);
      if (RUNS.length === 1) sceneOver(column, run, frames);
      worstScenes(column, run, details);
    }
    run.unpacked = { details, frames };
  }
  if (RUNS.length === 2) {
    const card = comparison(RUNS);
    document.getElementById("runs").before(card);
    comparedScene(card, RUNS);
  }
  redraw();
  // For tests: what was unpacked.
  Object.assign(document.body.dataset, { ready: "true", scenes: scenes.map(({ draws }) => draws).join(" ") });
}

themeButton(document.getElementById("theme"), redraw);
let waiting = 0;
addEventListener("resize", () => {
  clearTimeout(waiting);
  waiting = setTimeout(() => later.forEach((draw) => draw()), 100);
});
// Paper is light.
let shown;
addEventListener("beforeprint", () => {
  shown = root.dataset.theme;
  root.dataset.theme = "light";
  redraw();
});
addEventListener("afterprint", () => {
  root.dataset.theme = shown;
  redraw();
});
build();
