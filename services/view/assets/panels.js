"use strict";
// The cards of the live page: the agent, the list of agents, conflicts, quality, and the status of the run.

// The ego vehicle's path as positions in cm, the present one first; null if it is unknown.
function egoPath({ ego, g }) {
  if (!ego || !g || !g.length) return null;
  const [x, y] = [ego[0] * 100, ego[1] * 100];
  return Array.from({ length: g.length / 2 + 1 }, (_, step) => (step ? [x + g[2 * step - 2], y + g[2 * step - 1]] : [x, y]));
}

// The distance in m of an agent from the ego vehicle's path, now or on its single best forecast at the same time.
function distanceFromPath(path, { p, f }) {
  const apart = path.map(([x, y], step) => {
    const now = Math.hypot(p[0] - x, p[1] - y);
    const at = 2 * step - 2;
    return step && f && at < f.b.length ? Math.min(now, Math.hypot(p[0] + f.b[at] - x, p[1] + f.b[at + 1] - y)) : now;
  });
  return Math.min(...apart) / 100;
}

function showLegend(tick) {
  const causes = new Set([0]);
  for (const { counts } of ring.ticks) counts.forEach((count, cause) => count && causes.add(cause));
  const isOn = (layer, html) => (scene.layers[layer] ? html : "");
  const html = legendOf([...causes].sort(), '<span class="key"><i class="dash"></i>held</span>' +
    '<span class="key"><i class="dots"></i>kinematic</span>' +
    isOn("regions", '<span class="key"><i class="area"></i>50 / 90 % region at the end</span>') +
    isOn("histories", '<span class="key"><i class="line" style="background:var(--soft)"></i>history</span>') +
    isOn("places", '<span class="key"><i style="background:var(--faint)"></i>places seen</span>') +
    (scene.lanes.length ? isOn("lanes", '<span class="key"><i class="line" style="background:var(--lane)"></i>lanes</span>') : "") +
    isOn("truth", '<span class="key"><i class="line" style="background:var(--ink)"></i>where they went</span>') +
    isOn("conflicts", '<span class="key"><span class="bad">⊗</span>conflict</span>') +
    (tick.ego ? '<span class="key"><i style="background:var(--ego)"></i>ego</span>' : "") +
    (scene.selected ? `<span class="key"><i class="line dashes" style="color:var(--select)"></i>forecasts of ${PAST_S.join(", ")} s ago</span>` : ""));
  if (live.legend !== html) $("keys").innerHTML = live.legend = html;
}

// The kept ticks of the charts: up to the shown one.
function shownTicks() {
  const end = shownOrdinal() - ring.first + 1;
  const from = ring.ticks.findIndex(({ s }) => s >= ring.ticks[end - 1].s - SHOWN_S);
  return ring.ticks.slice(from, end);
}

function showQuality() {
  const ticks = shownTicks();
  const layers = LOOKS.map(({ cause }, place) => ({
    color: themed("cause-" + cause), values: ticks.map(({ counts }) => counts[place] || 0),
  }));
  stackedChart($("quality-chart"), ticks.map(({ s }) => s), layers);
  const texts = shownTick().counts.map((count, cause) => (count ? `${count} ${causeWords(cause)}` : ""));
  $("qualities").textContent = texts.filter(Boolean).join(" · ");
}

const metres = (cm) => (cm === NONE || cm === undefined ? null : cm / 100);

function showAgent() {
  const id = scene.selected;
  const kept = id ? ring.series(id) : [];
  $("agent").hidden = !kept.length;
  scene.past = pastOf(id, shownTick());
  if (!kept.length) return;
  const now = scene.scene.agents.find((agent) => agent.i === id);
  const at = shownTick().s;
  const last = now || (kept.findLast(([tick]) => tick.s <= at) || kept[0])[1];
  const speed = Math.hypot(...last.v) / 100;
  $("agent-name").textContent = `${TYPES[last.t]} ${last.n}${now ? "" : ", gone"}`;
  const { f } = last;
  const age = f && f.a ? ` · controls ${f.a} ms old` : "";
  $("agent-facts").textContent = `${speed.toFixed(1)} m/s · ${f ? QUALITIES[f.q] : "no forecast"}${age}`;
  $("why").innerHTML = f ? `${glyphOf(f.c)} ${escaped(explanationOf(f.c, last.t, f.x && f.x[STEADY]))}.` : "";
  const past = scene.past.map(({ age }) => age);
  $("past").textContent = past.length ? `Dashed in the scene: its forecasts of ${past.join(", ")} s ago${live.at === null ? "" : "; solid: where it went"}.` : "";
  const [context, width, height] = canvasOf($("agent-quality"));
  const times = kept.map(([tick]) => tick.s);
  const [begin, end] = [times[0], Math.max(times[times.length - 1], times[0] + 1)];
  const px = (s) => (s - begin) / (end - begin) * (width - CHART_LEFT - CHART_RIGHT) + CHART_LEFT;
  let from = 0;
  kept.forEach(([tick, agent], place) => {
    const color = colorOf(scene.colors, agent.f);
    const next = kept[place + 1];
    if (next && colorOf(scene.colors, next[1].f) === color && next[0].s - tick.s < 0.5) return;
    context.fillStyle = color;
    context.fillRect(px(times[from]), 2, Math.max(px(Math.min(tick.s + 0.08, end)) - px(times[from]), 1), height - 4);
    from = place + 1;
  });
  context.fillStyle = themed("ink");
  context.fillRect(px(Math.min(Math.max(at, begin), end)) - 1, 0, 2, height);
  lineChart($("agent-error"), times, [
    { values: kept.map(([, { steady }]) => metres(steady)), color: themed("faint") },
    { values: kept.map(([, { error }]) => metres(error)), color: themed("cause-none") },
  ], { mark: at });
  lineChart($("agent-jump"), times, [{ values: jumpsOf(kept), color: themed("select") }], { mark: at });
  live.agentTimes = [begin, end];
  const before = weightsOf(id, shownTick().t - 1);
  const rows = (f && f.x ? f.x : []).map((weight, slot) => [weight, expertOf(slot, last.t), before[slot]]).filter(([now, , then]) => now > 0 || then > 0);
  rows.sort((a, b) => b[0] - a[0]);
  const share = (weight) => (weight === undefined ? "–" : `${(weight / 10).toFixed(0)} %`);
  const outside = f ? `<tr><td>distance from the training data</td><td></td><td>${(f.o / 100).toFixed(2)}</td><td></td></tr>` : "";
  $("agent-evidence").innerHTML = rows.map(([weight, name, then]) =>
    `<tr><td>${name}</td><td style="width:32%"><div class="bar"><b></b><b style="width:${weight / 10}%"></b></div></td>` +
    `<td>${share(weight)}</td><td class="soft">${share(then)}</td></tr>`).join("") +
    (rows.length ? "" : "<tr><td class=soft>not reported</td></tr>") + outside;
}

// How far the end of each forecast of a series moved against the agent since the tick before, in m.
function jumpsOf(kept) {
  return kept.map(([tick, { p, f }], at) => {
    const [before, { p: q, f: g } = {}] = kept[at - 1] || [];
    if (!before || tick.s - before.s > 0.5 || !f || !g || !f.b.length || f.b.length !== g.b.length) return null;
    const end = f.b.length - 2;
    const step = tick.s - before.s;
    // The time of the end moves too: by the last step's motion.
    const last = [0, 1].map((axis) => (f.b[end + axis] - (end >= 2 ? f.b[end - 2 + axis] : 0)) / tick.dt * step);
    return Math.hypot(...[0, 1].map((axis) => p[axis] + f.b[end + axis] - q[axis] - g.b[end + axis] - last[axis])) / 100;
  });
}

// The weights of the experts for an agent at a time; none without a forecast.
function weightsOf(id, t) {
  const tick = ring.nearest(t, 0.25);
  const place = tick ? tick.ids.indexOf(id) : -1;
  const { f } = place < 0 ? {} : ring.agent(tick, place, true);
  return f ? f.x : [];
}

// The list of agents: rows stay the same elements, so that a click between two ticks is not lost.
const agentRows = new Map();

function showAgents(shown, path) {
  $("agents").tHead.innerHTML ||= "<tr><th>id</th><th class=left>type</th><th>m/s</th><th class=left>quality</th><th>error</th><th>path</th></tr>";
  $("order").textContent = path ? "m; nearest to the ego's path first" : "mean error, m; largest first";
  const wanted = $("search").value.trim().toLowerCase();
  const rows = shown.agents.map((agent) => ({ agent, near: path ? distanceFromPath(path, agent) : null }))
    .filter(({ agent }) => !wanted || `${agent.n} ${TYPES[agent.t]} ${agent.f ? `${QUALITIES[agent.f.q]} ${causeWords(agent.f.c)}` : ""}`.includes(wanted));
  rows.sort((a, b) => (path ? a.near - b.near : (b.agent.meanError ?? NONE) - (a.agent.meanError ?? NONE)));
  const present = new Set(rows.map(({ agent }) => agent.i));
  for (const [id, row] of agentRows) {
    if (!present.has(id)) {
      row.remove();
      agentRows.delete(id);
    }
  }
  const body = $("agents").tBodies[0];
  rows.forEach(({ agent, near }, place) => {
    let row = agentRows.get(agent.i);
    if (!row) {
      row = document.createElement("tr");
      row.dataset.id = agent.i;
      row.tabIndex = 0;
      agentRows.set(agent.i, row);
    }
    const { f } = agent;
    const html = `<td>${escaped(agent.n)}</td><td class=left>${TYPES[agent.t]}</td><td>${(Math.hypot(...agent.v) / 100).toFixed(1)}</td>` +
      `<td class=left>${f ? `${glyphOf(f.c, true)} ${QUALITIES[f.q]}` : "–"}</td><td>${shortNumber(metres(agent.meanError))}</td>` +
      `<td>${near === null ? "–" : near.toFixed(1)}</td>`;
    if (row.shown !== html) row.innerHTML = row.shown = html;
    row.setAttribute("aria-selected", String(agent.i === scene.selected));
    if (body.rows[place] !== row) body.insertBefore(row, body.rows[place] || null);
  });
}

function select(id) {
  scene.selected = id;
  const agent = scene.scene && scene.scene.agents.find((agent) => agent.i === id);
  if (agent && !scene.isOnScreen(agent.p, -10)) scene.lookAt(agent.p);
  refresh();
}

function showConflicts({ agents, k = [], ego }) {
  const name = (agent) => (agent ? escaped(`${TYPES[agent.t]} ${agent.n}`) : "<b>ego</b>");
  const names = (a, b) => (a && b && a.t === b.t ? escaped(`${PLURALS[a.t]} ${a.n} – ${b.n}`) : `${name(a)} – ${name(b)}`);
  const html = k.map(([a, b, p, m, t, x, y]) => `<tr data-id="${escaped((agents[a] || agents[b]).i)}" data-x="${x}" data-y="${y}">` +
    `<td>${names(agents[a], agents[b])}</td><td>${(t / 1000).toFixed(1)} s</td><td class="${p > 200 ? "bad" : ""}">${Math.round(p / 10)} %</td>` +
    `<td class=soft>${Math.round(m / 10)} %</td></tr>`).join("");
  const head = '<tr><th>agents</th><th>in</th><th>probability</th><th>if nobody reacts</th></tr>';
  const all = html ? head + html : '<tr><td class="soft">none within the horizon</td></tr>';
  if (live.conflicts !== all) $("conflicts").innerHTML = live.conflicts = all;
  $("conflict-note").textContent = ego ? "the ego keeps its speed and turn" : "";
}


// The latency above which a tick is late, in ms; null if the source waits for the forecasts.
const limitOf = ({ run, late_limit_ms: limit }) => (run.lockstep ? null : limit);

function figure(value, name, tone = "") {
  return `<div class="figure"><b class="${tone}">${value}</b><span>${name}</span></div>`;
}

function showStatus(status) {
  live.status = status;
  const { report, recent_end_to_end_ms: recent } = status;
  // In lockstep no tick is late.
  const limit = limitOf(report);
  $("title").textContent = `${status.title || "detections of a producer"} · run ${status.run}`;
  $("limit").textContent = limit ? `limit ${shortNumber(limit)} ms` : "";
  const tone = (value) => (limit && value > limit ? "bad" : "");
  $("latency").innerHTML = ["p50", "p99", "max"].map((name) =>
    figure(shortNumber(recent[name]), `${name}, ms`, tone(recent[name]))).join("");
  const interval = (report.run.interval_ms || 80) / 1000;
  const latencies = status.recent_latencies_ms;
  lineChart($("latency-chart"), latencies.map((_, place) => place * interval),
    [{ values: latencies, color: themed("accent") }], { limit, unit: "ms" });
  $("stages").innerHTML = "<tr><th>stage</th><th></th><th>p50</th><th>p99</th><th>budget</th><th>restarts</th></tr>" +
    status.stages.map((stage) => {
      const { p50, p99 } = stage.recent_compute_ms;
      const share = (value) => Math.min(100 * (value || 0) / (stage.budget_ms || Infinity), 100).toFixed(1);
      const over = stage.budget_ms && p99 > stage.budget_ms;
      const isSilent = stage.alive === false || !["", "running"].includes(stage.process.state);
      const state = isSilent ? ` <span class="bad">${escaped(stage.process.state || "silent")}</span>` : "";
      const bar = `<div class="bar${over ? " over" : ""}"><b style="width:${share(p99)}%"></b>` +
        `<b style="width:${share(p50)}%"></b></div>`;
      return `<tr><td>${escaped(stage.name)}${state}</td><td>${stage.budget_ms ? bar : ""}</td>` +
        `<td>${shortNumber(p50)}</td><td class="${over ? "bad" : ""}">${shortNumber(p99)}</td>` +
        `<td class="soft">${shortNumber(stage.budget_ms)}</td>` +
        `<td class="${stage.process.restarts ? "bad" : "soft"}">${stage.process.restarts}</td></tr>`;
    }).join("");
  if ($("graph-box").open) $("graph").innerHTML = graphOf(report, $("graph").clientWidth);
  const restarts = status.stages.reduce((sum, stage) => sum + stage.process.restarts, 0);
  const bad = (count) => (count ? "bad" : "good");
  $("health").innerHTML = (limit ? figure(report.late_ticks, "late ticks", bad(report.late_ticks)) : figure(report.late_ticks, `ticks over ${shortNumber(report.late_limit_ms)} ms`)) +
    figure(report.drops, "lost frames", bad(report.drops)) + figure(restarts, "restarts", bad(restarts)) +
    figure(live.missed, "ticks skipped here", live.missed ? "warn" : "");
  const reasons = report.verdict.reasons;
  $("doubts").innerHTML = reasons.map((reason) => `<li class="warn">${escaped(reason)}</li>`).join("") ||
    '<li class="good">nothing late, lost or doubtful</li>';
  markAlarms(reasons);
  $("events").innerHTML = status.events.slice(-8).reverse().map(({ elapsed_s, text }) =>
    `<li>${elapsed_s.toFixed(1)} s&ensp;${escaped(text)}</li>`).join("");
  setState(...(VERDICTS[report.verdict.status] || [report.verdict.status, "soft"]));
}


function showWorst(worst) {
  const html = worst.slice(0, 5).map(({ tick, end_to_end_ms, ticks_lost, cause }) => {
    const time = end_to_end_ms === null ? `${ticks_lost} ${ticks_lost === 1 ? "tick" : "ticks"} without forecasts` : `${shortNumber(end_to_end_ms)} ms`;
    const isKept = ordinalOf(tick) !== null;
    return `<button data-seq="${tick}" ${isKept ? "" : 'disabled title="The page no longer holds this tick"'}>tick ${tick} · ${time}<br>` +
      `<span class="soft">${escaped(cause)}</span></button>`;
  }).join("");
  if (live.worst !== html) $("worst").innerHTML = live.worst = html;
}
