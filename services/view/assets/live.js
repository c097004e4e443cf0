"use strict";
// The live page: takes the events of the server and shows the newest of each.

const $ = (id) => document.getElementById(id);
const KEPT_S = 30;
const live = {
  hello: null, status: null, missed: 0, paused: false, ended: false, ticks: 0, begun: performance.now(),
  history: [], // of ticks: time, forecasts by cause
  agents: new Map(), // by track: samples of the last 30 s
};
const scene = new SceneCanvas($("scene"), {
  onPick: () => showAgent(),
  onFollow: (what) => $("ego").setAttribute("aria-pressed", String(what === "ego")),
});
window.live = live;
window.sceneCanvas = scene;

function takeTick({ missed, scene: tick }) {
  live.missed = missed;
  live.ticks++;
  $("notice").hidden = true;
  remember(tick);
  if (live.paused) return;
  scene.show(tick);
  $("ego").hidden = !tick.ego;
  const seconds = live.first === undefined ? 0 : tick.t - live.first;
  live.first ??= tick.t;
  $("clock").textContent = `tick ${tick.seq} · ${seconds.toFixed(1)} s · ${tick.agents.length} agents`;
  // Charts and texts change four times a second; the scene with every tick.
  const now = performance.now();
  if (live.shown === undefined || now - live.shown > 240) {
    live.shown = now;
    showDetails();
  }
}

function showDetails() {
  if (!scene.scene) return;
  showQuality();
  showAgent();
  showLegend(scene.scene);
  // For tests: what was received and drawn.
  const agents = scene.scene.agents.length;
  Object.assign($("scene").dataset, { ticks: live.ticks, draws: scene.draws, missed: live.missed, agents });
}

// Keeps the history of qualities, and of each agent the forecasts that later positions are compared with.
function remember(tick) {
  const counts = CAUSES.map(() => 0);
  for (const agent of tick.agents) {
    if (agent.f) counts[agent.f.c] = (counts[agent.f.c] || 0) + 1;
    let kept = live.agents.get(agent.i);
    if (!kept) live.agents.set(agent.i, kept = []);
    const error = errorOf(kept, tick, agent);
    kept.push({ t: tick.t, p: agent.p, v: agent.v, f: agent.f, dt: tick.dt, error });
    while (kept.length && kept[0].t < tick.t - KEPT_S) kept.shift();
  }
  live.history.push({ t: tick.t, counts });
  while (live.history.length && live.history[0].t < tick.t - KEPT_S) live.history.shift();
  for (const [id, kept] of live.agents) {
    if (kept[kept.length - 1].t < tick.t - KEPT_S) live.agents.delete(id);
  }
}

// The distances in m between an agent and where it was expected 2 s ago: published, and at constant velocity.
function errorOf(kept, tick, agent) {
  const [wanted, near] = [tick.t - 2, 0.25];
  let found = null;
  for (const entry of kept) {
    if (Math.abs(entry.t - wanted) < (found ? Math.abs(found.t - wanted) : near)) found = entry;
  }
  if (!found || !found.f || !found.f.b.length) return null;
  const ahead = tick.t - found.t;
  const at = ahead / found.dt - 1; // place between the steps
  const [low, share] = [Math.floor(at), at - Math.floor(at)];
  const step = (k, axis) => (k < 0 ? 0 : found.f.b[2 * k + axis]);
  if (2 * (low + (share > 1e-6 ? 1 : 0)) + 1 >= found.f.b.length) return null;
  const expected = [0, 1].map((axis) => {
    const [a, b] = [step(low, axis), share > 1e-6 ? step(low + 1, axis) : 0];
    return found.p[axis] + (share > 1e-6 ? a + (b - a) * share : a);
  });
  const steady = [0, 1].map((axis) => found.p[axis] + found.v[axis] * ahead);
  const apart = (point) => Math.hypot(point[0] - agent.p[0], point[1] - agent.p[1]) / 100;
  return [apart(expected), apart(steady)];
}

function showLegend(tick) {
  const causes = new Set([0]);
  for (const { counts } of live.history) counts.forEach((count, cause) => count && causes.add(cause));
  const lanes = scene.lanes.length ? '<span class="key"><i class="line" style="background:var(--lane)"></i>lanes</span>'
    : "";
  const ego = tick.ego ? '<span class="key"><i style="background:var(--ego)"></i>ego</span>' : "";
  const html = legendOf([...causes].sort(), '<span class="key"><i class="dash"></i>held</span>' +
    '<span class="key"><i class="dots"></i>kinematic</span>' +
    '<span class="key"><i class="area"></i>50 / 90 % region at the end</span>' +
    '<span class="key"><i class="line" style="background:var(--soft)"></i>history</span>' +
    '<span class="key"><i style="background:var(--faint)"></i>places seen</span>' + lanes + ego);
  if (live.legend !== html) $("legend").innerHTML = live.legend = html;
}

function showQuality() {
  const x = live.history.map(({ t }) => t);
  const layers = CAUSES.map((cause, place) => ({
    color: themed("cause-" + cause), values: live.history.map(({ counts }) => counts[place]),
  }));
  stackedChart($("quality-chart"), x, layers);
  const newest = live.history[live.history.length - 1];
  const texts = newest ? newest.counts.map((count, cause) => count ? `${count} ${causeWords(cause)}` : "") : [];
  $("qualities").textContent = texts.filter(Boolean).join(" · ");
}

function showAgent() {
  const id = scene.selected;
  const kept = id && live.agents.get(id);
  $("agent").hidden = !kept;
  if (!kept) return;
  const newest = scene.scene.agents.find((agent) => agent.i === id);
  const last = kept[kept.length - 1];
  const speed = Math.hypot(...last.v) / 100;
  $("agent-name").textContent = newest ? `${TYPES[newest.t]} ${newest.n}` : `track ${id}, gone`;
  const cause = last.f ? causeWords(last.f.c) : "no forecast";
  const quality = last.f ? QUALITIES[last.f.q] : "";
  const age = last.f && last.f.a ? `, ${last.f.a} ms old` : "";
  $("agent-facts").textContent = `${speed.toFixed(1)} m/s · ${quality}${quality === cause ? "" : " (" + cause + ")"}${age}`;
  const [context, width, height] = canvasOf($("agent-quality"));
  const begin = last.t - KEPT_S;
  kept.forEach((entry, place) => {
    const next = place + 1 < kept.length ? kept[place + 1].t : entry.t + 0.08;
    context.fillStyle = colorOf(scene.colors, entry.f);
    const [x0, x1] = [entry.t, next].map((t) => (t - begin) / KEPT_S * (width - 46) + 36);
    context.fillRect(x0, 2, Math.max(x1 - x0 + 0.5, 1), height - 4);
  });
  lineChart($("agent-error"), kept.map(({ t }) => t), [
    { values: kept.map(({ error }) => error && error[1]), color: themed("faint") },
    { values: kept.map(({ error }) => error && error[0]), color: themed("cause-none") },
  ], {});
  const weights = last.f ? last.f.x : [];
  const rows = weights.map((weight, place) => [weight, EXPERTS[place]]).filter(([weight]) => weight > 0);
  rows.sort((a, b) => b[0] - a[0]);
  const bar = (share) => `<div class="bar"><b></b><b style="width:${share}%"></b></div>`;
  const outside = last.f ? `<tr><td>distance from the training data</td><td></td><td>${(last.f.o / 100).toFixed(2)}</td></tr>` : "";
  $("agent-evidence").innerHTML = rows.map(([weight, name]) =>
    `<tr><td>${name}</td><td style="width:45%">${bar(weight / 10)}</td><td>${(weight / 10).toFixed(0)} %</td></tr>`)
    .join("") + (rows.length ? "" : "<tr><td class=soft>not reported</td></tr>") + outside;
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
  const restarts = status.stages.reduce((sum, stage) => sum + stage.process.restarts, 0);
  const bad = (count) => (count ? "bad" : "good");
  $("health").innerHTML = figure(report.late_ticks, "late ticks", bad(report.late_ticks)) +
    figure(report.drops, "lost frames", bad(report.drops)) + figure(restarts, "restarts", bad(restarts)) +
    figure(live.missed, "ticks not shown here", live.missed ? "warn" : "");
  const reasons = report.verdict.reasons;
  $("doubts").innerHTML = reasons.map((reason) => `<li class="warn">${escaped(reason)}</li>`).join("") ||
    '<li class="good">nothing late, lost or doubtful</li>';
  $("events").innerHTML = status.events.slice(-8).reverse().map(({ elapsed_s, text }) =>
    `<li>${elapsed_s.toFixed(1)} s&ensp;${escaped(text)}</li>`).join("");
  const names = { ok: ["OK", "good"], doubtful: ["DOUBTFUL", "warn"], degraded: ["DEGRADED", "bad"], empty: ["EMPTY", "warn"] };
  const [word, tone2] = names[report.verdict.status] || [report.verdict.status, "soft"];
  setState(word, tone2);
}

function setState(text, tone) {
  if (live.ended) return;
  $("state").textContent = text;
  $("state").className = "pill " + tone;
}

function notice(text) {
  $("notice").hidden = false;
  $("notice").textContent = text;
}

function listen() {
  const source = new EventSource("events" + location.search);
  const on = (name, take) => source.addEventListener(name, (event) => take(JSON.parse(event.data)));
  on("hello", (hello) => {
    live.hello = hello;
    scene.lanes = hello.lanes || [];
    $("title").textContent = hello.title;
    document.title = `${hello.title} · stgdat`;
  });
  on("tick", takeTick);
  on("status", showStatus);
  on("end", () => {
    source.close();
    scene.draw();
    showDetails();
    setState("ended", "soft");
    live.ended = true;
    notice("The run has ended");
  });
  source.addEventListener("error", () => setState("no connection", "bad"));
}

$("fit").addEventListener("click", () => { scene.setFollow(null); scene.fit(); scene.request(); });
$("ego").addEventListener("click", () => {
  scene.setFollow(scene.follow === "ego" ? null : "ego");
  scene.request();
});
$("pause").addEventListener("click", () => {
  live.paused = !live.paused;
  $("pause").setAttribute("aria-pressed", String(live.paused));
});
themeButton($("theme"), () => {
  scene.theme();
  if (live.status) showStatus(live.status);
  showQuality();
  showAgent();
});
listen();
