"use strict";
// The live page: keeps the last ticks of the server's events, and shows one of them: the newest, or an earlier one.

const $ = (id) => document.getElementById(id);
const SHOWN_S = 30; // of the charts
const PAST_S = [1, 2, 4];
const live = {
  hello: null, status: null, missed: 0, ended: false, ticks: 0,
  at: null, // the ordinal of the shown tick; null for the newest
  playing: null, // since when time runs from an earlier tick
  reasons: null, // of the verdict, as last seen
};
const ring = new Ring();
const scene = new SceneCanvas($("scene"), {
  onPick: () => showDetails(),
  onFollow: (what) => $("ego").setAttribute("aria-pressed", String(what === "ego")),
});
Object.assign(window, { live, ring, sceneCanvas: scene });

// Whether time runs in the scene.
const isRunning = () => Boolean(live.playing) || (live.at === null && !live.ended);
const shownOrdinal = () => (live.at === null ? ring.newest : Math.min(Math.max(live.at, ring.first), ring.newest));
const shownTick = () => ring.tick(shownOrdinal());

function takeTick({ missed, scene: tick }) {
  live.missed = missed;
  live.ticks++;
  $("notice").hidden = true;
  const before = ring.tick(ring.newest);
  const kept = ring.push(tick);
  mark(kept, before);
  if (!before && tick.ego) scene.setFollow("ego");
  if (live.at !== null && live.at < ring.first) live.at = ring.first;
  if (live.at === null) showTick();
  detailsSoon();
}

// Marks what happened at a tick.
function mark(tick, before) {
  const limit = live.status && live.status.report.late_limit_ms;
  const isLockstep = live.status && live.status.report.run.lockstep;
  if (limit && !isLockstep && tick.latency > limit) tick.marks.push(["late", `${shortNumber(tick.latency)} ms from end to end`]);
  if (!before) return;
  for (const [stage, starts] of Object.entries(tick.starts)) {
    if (starts > (before.starts[stage] || 0)) tick.marks.push(["restart", `${stage} was restarted`]);
  }
  if (tick.doubts & ~before.doubts) tick.marks.push(["doubt", "a new doubt about the input"]);
}

function showTick() {
  if (!ring.ticks.length) return;
  const ordinal = shownOrdinal();
  const tick = ring.tick(ordinal);
  const isOld = ordinal < ring.newest;
  scene.later = isOld && scene.layers.truth ? ring.later(ordinal) : null;
  scene.past = pastOf(scene.selected, tick);
  if (isOld && scene.selected && scene.past.length) {
    // What it did is drawn beside what was expected.
    scene.later ??= new Map([...ring.later(ordinal)].filter(([id]) => id === scene.selected));
  }
  scene.show(ring.scene(ordinal));
  scene.keepInView();
  $("ego").hidden = !tick.ego;
  $("clock").textContent = `tick ${tick.seq} · stamp ${tick.t.toFixed(3)} s · ${tick.ids.length} agents`;
  const newest = ring.tick(ring.newest);
  Object.assign($("scrub"), { min: ring.first, max: ring.newest, value: ordinal });
  $("when").textContent = live.at === null ? (live.ended ? "the end" : "live") : `−${(newest.s - tick.s).toFixed(1)} s`;
  $("live").textContent = live.ended ? "End" : "Live";
  $("live").setAttribute("aria-pressed", String(live.at === null));
  $("pause").textContent = isRunning() ? "Pause" : "Play";
}

// Goes to a kept tick; null is the newest.
function goTo(ordinal) {
  live.playing = null;
  live.at = ordinal === null ? null : Math.min(Math.max(ordinal, ring.first), ring.newest);
  refresh();
}

function refresh() {
  if (live.refreshes) return;
  live.refreshes = true;
  requestAnimationFrame(() => {
    live.refreshes = false;
    showTick();
    detailsSoon();
  });
}

// Charts and texts change four times a second; the scene with every tick.
function detailsSoon() {
  const left = 240 - (performance.now() - (live.shown ?? -Infinity));
  if (left > 0) {
    live.later ??= setTimeout(showDetails, left);
  } else showDetails();
}

// The ordinal of the kept tick with a number, or of the next one; null if it is older.
function ordinalOf(seq) {
  if (!ring.ticks.length || ring.ticks[0].seq > seq) return null;
  const place = ring.ticks.findIndex((tick) => tick.seq >= seq);
  return place < 0 ? null : ring.first + place;
}

// Lets time run from the shown tick.
function play() {
  if (shownOrdinal() === ring.newest) live.at = ring.first;
  live.playing = { from: performance.now(), s: ring.tick(shownOrdinal()).s };
  const step = () => {
    if (!live.playing) return;
    const s = live.playing.s + (performance.now() - live.playing.from) / 1000;
    let ordinal = shownOrdinal();
    while (ordinal < ring.newest && ring.tick(ordinal + 1).s <= s) ordinal++;
    if (ordinal !== live.at) {
      live.at = ordinal;
      refresh();
    }
    if (ordinal === ring.newest) return goTo(null);
    requestAnimationFrame(step);
  };
  step();
  showTick();
}

// The selected agent's forecasts of PAST_S ago.
function pastOf(id, tick) {
  if (!id) return [];
  return PAST_S.map((age) => {
    const earlier = ring.nearest(tick.t - age, 0.25);
    const place = earlier ? earlier.ids.indexOf(id) : -1;
    const agent = place >= 0 ? ring.agent(earlier, place) : null;
    return agent && agent.f && agent.f.b.length ? { age, p: agent.p, f: agent.f } : null;
  }).filter(Boolean);
}

function showDetails() {
  clearTimeout(live.later);
  live.later = null;
  const shown = scene.scene;
  if (!shown || !ring.ticks.length) return;
  showQuality();
  showAgent();
  showAgents(shown, egoPath(shown));
  showConflicts(shown);
  showLegend(shown);
  showMarks();
  if (live.status) showWorst(live.status.report.worst_ticks);
  // For tests: what was received and drawn.
  const agents = shown.agents.length;
  Object.assign($("scene").dataset, { ticks: live.ticks, draws: scene.draws, missed: live.missed, agents });
  live.shown = performance.now();
}

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
    (scene.selected ? `<span class="key"><i class="line" style="background:var(--select)"></i>forecasts of ${PAST_S.join(", ")} s ago</span>` : ""));
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
  const kept = id ? ring.series(id, ring.first, shownOrdinal()) : [];
  $("agent").hidden = !kept.length;
  scene.past = pastOf(id, shownTick());
  if (!kept.length) return;
  const now = scene.scene.agents.find((agent) => agent.i === id);
  const last = now || kept[kept.length - 1][1];
  const speed = Math.hypot(...last.v) / 100;
  $("agent-name").textContent = `${TYPES[last.t]} ${last.n}${now ? "" : ", gone"}`;
  const { f } = last;
  const age = f && f.a ? ` · controls ${f.a} ms old` : "";
  $("agent-facts").textContent = `${speed.toFixed(1)} m/s · ${f ? QUALITIES[f.q] : "no forecast"}${age}`;
  $("why").innerHTML = f ? `${glyphOf(f.c)} ${escaped(whyOf(last))}.` : "";
  const past = scene.past.map(({ age }) => age);
  $("past").textContent = past.length ? `Purple in the scene: its forecasts of ${past.join(", ")} s ago${live.at === null ? "" : "; dark: where it went"}.` : "";
  const [context, width, height] = canvasOf($("agent-quality"));
  const times = kept.map(([tick]) => tick.s);
  const [begin, end] = [times[0], Math.max(times[times.length - 1], times[0] + 1)];
  const px = (s) => (s - begin) / (end - begin) * (width - 46) + 36;
  let from = 0;
  kept.forEach(([tick, agent], place) => {
    const color = colorOf(scene.colors, agent.f);
    const next = kept[place + 1];
    if (next && colorOf(scene.colors, next[1].f) === color && next[0].s - tick.s < 0.5) return;
    context.fillStyle = color;
    context.fillRect(px(times[from]), 2, Math.max(px(Math.min(tick.s + 0.08, end)) - px(times[from]), 1), height - 4);
    from = place + 1;
  });
  lineChart($("agent-error"), times, [
    { values: kept.map(([, { steady }]) => metres(steady)), color: themed("faint") },
    { values: kept.map(([, { error }]) => metres(error)), color: themed("cause-none") },
  ], {});
  const rows = (f && f.x ? f.x : []).map((weight, place) => [weight, expertOf(place, last.t)]).filter(([weight]) => weight > 0);
  rows.sort((a, b) => b[0] - a[0]);
  const bar = (share) => `<div class="bar"><b></b><b style="width:${share}%"></b></div>`;
  const outside = f ? `<tr><td>distance from the training data</td><td></td><td>${(f.o / 100).toFixed(2)}</td></tr>` : "";
  $("agent-evidence").innerHTML = rows.map(([weight, name]) =>
    `<tr><td>${name}</td><td style="width:38%">${bar(weight / 10)}</td><td>${(weight / 10).toFixed(0)} %</td></tr>`)
    .join("") + (rows.length ? "" : "<tr><td class=soft>not reported</td></tr>") + outside;
}

function expertOf(place, type) {
  const onFoot = TYPES[type] === "pedestrian" && EXPERTS_ON_FOOT[place];
  return onFoot || EXPERTS[place] || `expert ${place}`;
}

// Why an agent's forecast is as it is, in a sentence.
function whyOf({ t, f }) {
  const steady = f.x && f.x[EXPERTS.indexOf("constant velocity")];
  const text = explanationOf(f.c, t);
  return f.c > 0 && LOOKS[f.c] && LOOKS[f.c].normal && steady ? text.replace("most of the weight", `most of the weight (${(steady / 10).toFixed(0)} %)`) : text;
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

// The marks of the time line: those that would cover each other are joined.
const MARK_SHAPES = { late: "triangle", restart: "diamond", doubt: "ring", alarm: "square" };
function showMarks() {
  const { first, newest } = ring;
  const width = Math.max($("marks").clientWidth, 1);
  const groups = new Map();
  for (let ordinal = first; ordinal <= newest; ordinal++) {
    for (const [kind, text] of ring.tick(ordinal).marks) {
      const share = (ordinal - first) / Math.max(newest - first, 1);
      const key = kind + Math.floor(share * width / 12);
      const group = groups.get(key) || { kind, ordinal, share, texts: [] };
      group.texts.push(`tick ${ring.tick(ordinal).seq}: ${text}`);
      groups.set(key, group);
    }
  }
  const html = [...groups.values()].map(({ kind, ordinal, share, texts }) =>
    `<button class="${kind}" data-ordinal="${ordinal}" style="left:${(share * 100).toFixed(2)}%" title="${escaped(texts.slice(0, 6).join("\n"))}">` +
    `<svg width="14" height="14" viewBox="-6 -6 12 12"><path d="${SHAPES[MARK_SHAPES[kind]]}" fill="${kind === "doubt" ? "none" : "currentColor"}" stroke="currentColor" stroke-width="1.6"/></svg></button>`).join("");
  if (live.marks !== html) $("marks").innerHTML = live.marks = html;
  showStrip();
}

// Latencies along the time line; a bar that reaches the top is at the limit.
function showStrip() {
  const [context, width, height] = canvasOf($("strip"));
  const limit = (live.status && live.status.report.late_limit_ms) || Math.max(...ring.ticks.map(({ latency }) => latency || 0), 1);
  context.fillStyle = themed("grid");
  context.fillRect(0, 0, width, height);
  const columns = Math.max(Math.floor(width), 1);
  for (let column = 0; column < columns; column++) {
    const [from, to] = [column, column + 1].map((at) => Math.floor(at * ring.ticks.length / columns));
    let most = null;
    for (let place = from; place < Math.max(to, from + 1) && place < ring.ticks.length; place++) most = Math.max(most, ring.ticks[place].latency);
    if (most === null) continue;
    context.fillStyle = themed(most > limit ? "bad" : "accent");
    const tall = Math.max(Math.min(most / limit, 1) * height, 1);
    context.fillRect(column, height - tall, 1, tall);
  }
}

function figure(value, name, tone = "") {
  return `<div class="figure"><b class="${tone}">${value}</b><span>${name}</span></div>`;
}

function showStatus(status) {
  live.status = status;
  const { report, recent_end_to_end_ms: recent } = status;
  const limit = report.late_limit_ms;
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
  if ($("graph-box").open) $("graph").innerHTML = graphOf(report.stages);
  const restarts = status.stages.reduce((sum, stage) => sum + stage.process.restarts, 0);
  const bad = (count) => (count ? "bad" : "good");
  $("health").innerHTML = figure(report.late_ticks, "late ticks", bad(report.late_ticks)) +
    figure(report.drops, "lost frames", bad(report.drops)) + figure(restarts, "restarts", bad(restarts)) +
    figure(live.missed, "ticks not shown here", live.missed ? "warn" : "");
  const reasons = report.verdict.reasons;
  $("doubts").innerHTML = reasons.map((reason) => `<li class="warn">${escaped(reason)}</li>`).join("") ||
    '<li class="good">nothing late, lost or doubtful</li>';
  markAlarms(reasons);
  $("events").innerHTML = status.events.slice(-8).reverse().map(({ elapsed_s, text }) =>
    `<li>${elapsed_s.toFixed(1)} s&ensp;${escaped(text)}</li>`).join("");
  setState(...(VERDICTS[report.verdict.status] || [report.verdict.status, "soft"]));
}

// Marks the newest tick if the verdict has a new reason. Numbers in a reason may change.
function markAlarms(reasons) {
  const kinds = new Map(reasons.map((reason) => [reason.replace(/[\d.,]+/g, "#"), reason]));
  for (const [kind, reason] of kinds) {
    if (live.reasons && !live.reasons.has(kind) && ring.ticks.length) ring.tick(ring.newest).marks.push(["alarm", reason]);
  }
  live.reasons = new Set(kinds.keys());
}

function showWorst(worst) {
  const html = worst.slice(0, 5).map(({ tick, end_to_end_ms, ticks_lost, cause }) => {
    const time = end_to_end_ms === null ? `${ticks_lost} ticks without forecasts` : `${shortNumber(end_to_end_ms)} ms`;
    const isKept = ordinalOf(tick) !== null;
    return `<button data-seq="${tick}" ${isKept ? "" : 'disabled title="The page no longer holds this tick"'}>tick ${tick} · ${time}<br>` +
      `<span class="soft">${escaped(cause)}</span></button>`;
  }).join("");
  if (live.worst !== html) $("worst").innerHTML = live.worst = html;
}

function setState(text, tone) {
  if (live.ended) return;
  $("state").textContent = text;
  $("state").className = "pill " + tone;
}

function listen() {
  const source = new EventSource("events" + location.search);
  const on = (name, take) => source.addEventListener(name, (event) => take(JSON.parse(event.data)));
  on("hello", (hello) => {
    live.hello = hello;
    scene.lanes = hello.lanes || [];
    $("title").textContent = hello.title;
    document.title = `${hello.title} · stgdat`;
    showLayers();
  });
  on("tick", takeTick);
  on("status", showStatus);
  on("end", () => {
    source.close();
    setState("ended", "soft");
    live.ended = true;
    showEnd();
  });
  source.addEventListener("error", () => setState("no connection", "bad"));
}

// The page keeps all that it has, and offers the report as far as it received it.
function showEnd() {
  $("ended").hidden = false;
  $("notice").hidden = true;
  if (ring.ticks.length) {
    const [oldest, newest] = [ring.tick(ring.first), ring.tick(ring.newest)];
    $("kept").textContent = `This page keeps its last ${(newest.s - oldest.s).toFixed(0)} s: ticks ${oldest.seq} to ${newest.seq}.`;
    goTo(null);
  }
  if (!live.status) return;
  const name = `${live.status.run.replace(/[^\w.-]/g, "_")}.json`;
  const link = $("report");
  link.href = URL.createObjectURL(new Blob([JSON.stringify(live.status.report)], { type: "application/json" }));
  Object.assign(link, { download: name, hidden: false });
  $("how").textContent = `stgdat report ${name} makes a page of it`;
}

function showLayers() {
  $("layers").innerHTML = LAYERS.filter(([name]) => name !== "lanes" || scene.lanes.length).map(([name, words]) =>
    `<label class="chip"><input type="checkbox" data-layer="${name}" ${scene.layers[name] ? "checked" : ""}>${words}</label>`).join("");
}

$("layers").addEventListener("change", ({ target }) => {
  scene.layers[target.dataset.layer] = target.checked;
  refresh();
});
$("fit").addEventListener("click", () => { scene.setFollow(null); scene.fit(); scene.request(); });
$("ego").addEventListener("click", () => {
  scene.setFollow(scene.follow === "ego" ? null : "ego");
  scene.request();
});
$("ruler").addEventListener("click", () => {
  scene.ruler = scene.ruler ? null : [];
  $("ruler").setAttribute("aria-pressed", String(Boolean(scene.ruler)));
  $("scene").classList.toggle("ruler", Boolean(scene.ruler));
  scene.request();
});
$("pause").addEventListener("click", () => {
  if (isRunning()) goTo(shownOrdinal()); else play();
});
$("back").addEventListener("click", () => goTo(shownOrdinal() - 1));
$("forth").addEventListener("click", () => goTo(shownOrdinal() + 1));
$("live").addEventListener("click", () => goTo(null));
$("scrub").addEventListener("input", () => goTo(+$("scrub").value));
$("marks").addEventListener("click", ({ target }) => {
  const button = target.closest("button");
  if (button) goTo(+button.dataset.ordinal);
});
$("worst").addEventListener("click", ({ target }) => {
  const button = target.closest("button");
  const ordinal = button && ordinalOf(+button.dataset.seq);
  if (ordinal !== null) goTo(ordinal);
});
$("search").addEventListener("input", showDetails);
for (const event of ["click", "keydown"]) {
  $("agents").addEventListener(event, ({ target, key }) => {
    const row = target.closest("tr[data-id]");
    if (row && (!key || key === "Enter")) select(row.dataset.id);
  });
}
$("graph-box").addEventListener("toggle", () => live.status && showStatus(live.status));
$("conflicts").addEventListener("click", ({ target }) => {
  const row = target.closest("tr[data-id]");
  if (!row) return;
  scene.selected = row.dataset.id;
  scene.lookAt([+row.dataset.x, +row.dataset.y]);
  refresh();
});
addEventListener("keydown", (event) => {
  if (event.target.type === "search" || event.ctrlKey || event.metaKey || event.altKey || event.shiftKey || !ring.ticks.length) return;
  const act = {
    ArrowLeft: () => goTo(shownOrdinal() - 1), ArrowRight: () => goTo(shownOrdinal() + 1), Home: () => goTo(ring.first),
    End: () => goTo(null), " ": () => $("pause").click(),
  }[event.key];
  if (!act || (event.key === " " && event.target.tagName === "BUTTON")) return;
  event.preventDefault();
  act();
});
themeButton($("theme"), () => {
  scene.theme();
  if (live.status) showStatus(live.status);
  showDetails();
});
if (innerWidth <= 500) $("legend").open = $("layers-box").open = false;
showLayers();
listen();
