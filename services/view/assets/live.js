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
  const limit = live.status && limitOf(live.status.report);
  if (limit && tick.latency > limit) tick.marks.push(["late", `${shortNumber(tick.latency)} ms from end to end`]);
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
  const limit = (live.status && limitOf(live.status.report)) || Math.max(...ring.ticks.map(({ latency }) => latency || 0), 1);
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

// Marks the newest tick if the verdict has a new reason. Numbers in a reason may change.
function markAlarms(reasons) {
  const kinds = new Map(reasons.map((reason) => [reason.replace(/[\d.,]+/g, "#"), reason]));
  for (const [kind, reason] of kinds) {
    if (live.reasons && !live.reasons.has(kind) && ring.ticks.length) ring.tick(ring.newest).marks.push(["alarm", reason]);
  }
  live.reasons = new Set(kinds.keys());
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
    if (!live.status) return;
    // Without storage, as in a private window, a reload has the newest tick alone.
    keepOrRestore(live.status.run, ring).then((isRestored) => isRestored && showEnd(), () => {}).finally(() => { live.kept = true; });
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
// A click on a chart of the agent goes to its tick.
for (const name of ["agent-jump", "agent-error", "agent-quality"]) {
  $(name).addEventListener("click", ({ offsetX, target }) => {
    const [begin, end] = live.agentTimes;
    const s = begin + (end - begin) * Math.min(Math.max((offsetX - CHART_LEFT) / (target.clientWidth - CHART_LEFT - CHART_RIGHT), 0), 1);
    const place = ring.ticks.findIndex((tick) => tick.s >= s - 1e-6);
    goTo(place < 0 ? null : ring.first + place);
  });
}
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
