"use strict";
// The pipeline as a graph: a box for each stage with its times against the budget, an arrow for each topic.

const BOX = { width: 146, height: 78, gap: 66 };

// The arrows between stages, from producer to consumer. `back` leads to an earlier stage of the next tick.
function arrowsOf(stages) {
  return stages.flatMap((producer, from) => (producer.writes || []).flatMap((topic) =>
    stages.map((consumer, to) => [consumer, to]).filter(([consumer]) => (consumer.reads || []).includes(topic))
      .map(([, to]) => ({ from, to, topic, back: to <= from }))));
}

// Two numbers in ms.
const pairOf = ({ p50, p99 }) => `${shortNumber(p50)} / ${shortNumber(p99)}`;

function boxOf(stage, x, y) {
  const { budget_ms: budget, compute_ms: compute } = stage;
  const over = budget && compute.p99 > budget;
  const lost = stage.drops.gap + stage.drops.refused + stage.drops.restart;
  const share = (value) => (BOX.width - 16) * Math.min((value || 0) / budget, 1);
  const bar = (value, tone, opacity) => `<rect x="8" y="33" width="${share(value).toFixed(1)}" height="5" rx="2" fill="var(--${tone})" opacity="${opacity}"/>`;
  const bars = budget ? `<rect x="8" y="33" width="${BOX.width - 16}" height="5" rx="2" fill="var(--line)"/>` +
    bar(compute.p99, over ? "bad" : "accent", 0.4) + bar(compute.p50, over ? "bad" : "accent", 1) : "";
  const faults = [lost && `${lost} lost`, stage.restarts && `${stage.restarts} restart${stage.restarts > 1 ? "s" : ""}`].filter(Boolean);
  return `<g transform="translate(${x} ${y})" data-stage="${escaped(stage.name)}"><title>${escaped(stage.name)}: compute ${pairOf(compute)} ms` +
    `${budget ? ` of ${budget} ms` : ""}, waiting ${pairOf(stage.waiting_ms)}, wake-up ${pairOf(stage.wake_up_ms)} (p50 / p99)</title>` +
    `<rect width="${BOX.width}" height="${BOX.height}" rx="8" fill="var(--panel)" stroke="var(--${faults.length || over ? "bad" : "line"})"/>` +
    `<text x="8" y="17" font-weight="600" fill="var(--ink)">${escaped(stage.name)}</text>` +
    `<text x="${BOX.width - 8}" y="17" text-anchor="end" fill="var(--bad)">${faults.join(", ")}</text>` +
    `<text x="8" y="29" fill="var(--${over ? "bad" : "soft"})">${pairOf(compute)}${budget ? ` of ${shortNumber(budget)}` : ""} ms</text>${bars}` +
    `<text x="8" y="53" fill="var(--soft)">waiting ${pairOf(stage.waiting_ms)}</text>` +
    `<text x="8" y="68" fill="var(--soft)">wake-up ${pairOf(stage.wake_up_ms)}</text></g>`;
}

// The graph of a report's stages as SVG; nothing if the report does not have their topics.
function graphOf(stages) {
  const arrows = arrowsOf(stages);
  if (!arrows.length) return "";
  const column = stages.map(() => 0);
  stages.forEach((_, to) => arrows.filter((arrow) => arrow.to === to && !arrow.back)
    .forEach(({ from }) => { column[to] = Math.max(column[to], column[from] + 1); }));
  const row = stages.map((_, place) => column.slice(0, place).filter((other) => other === column[place]).length);
  const rows = Math.max(...row) + 1;
  // Arrows over other boxes pass above them, arrows back below. Each has a height of its own.
  const far = arrows.filter(({ from, to, back }) => back || column[to] - column[from] > 1 || row[to] !== row[from]);
  const above = far.filter(({ back }) => !back);
  const below = far.filter(({ back }) => back);
  const top = 10 + 20 * above.length;
  const x = (place) => 4 + column[place] * (BOX.width + BOX.gap);
  const y = (place) => top + row[place] * (BOX.height + 26);
  const bottom = top + rows * (BOX.height + 26) - 26;
  const [width, height] = [8 + (Math.max(...column) + 1) * (BOX.width + BOX.gap) - BOX.gap, bottom + 10 + 20 * below.length];
  const line = (points, topic, at, dash) => `<path d="${points}" fill="none" stroke="var(--soft)" marker-end="url(#tip)"${dash ? ' stroke-dasharray="4 3"' : ""}/>` +
    `<text x="${at[0]}" y="${at[1]}" text-anchor="middle" fill="var(--soft)" stroke="var(--panel)" stroke-width="4" paint-order="stroke">${escaped(topic)}</text>`;
  const drawn = arrows.map((arrow) => {
    const { from, to, topic, back } = arrow;
    const [ax, ay, bx, by] = [x(from) + BOX.width, y(from) + BOX.height / 2, x(to), y(to) + BOX.height / 2];
    if (!far.includes(arrow)) return line(`M${ax} ${ay}H${bx - 2}`, topic, [(ax + bx) / 2, ay - 6], false);
    const number = (back ? below : above).indexOf(arrow);
    const level = back ? bottom + 14 + 20 * number : top - 12 - 20 * number;
    const [start, end] = [x(from) + BOX.width * 0.72 + 5 * number, x(to) + BOX.width * 0.22 + 5 * number];
    const [leave, enter] = back ? [y(from) + BOX.height, y(to) + BOX.height + 2] : [y(from), y(to) - 2];
    return line(`M${start} ${leave}V${level}H${end}V${enter}`, topic, [(start + end) / 2, level + 4], back);
  });
  return `<svg class="pipeline" viewBox="0 0 ${width} ${height}" style="width:100%;min-width:${Math.round(width * 0.7)}px" font-size="11.5" role="img" aria-label="Stages and topics">` +
    `<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto"><path d="M0 0L8 4L0 8Z" fill="var(--soft)"/></marker></defs>` +
    `${drawn.join("")}${stages.map((stage, place) => boxOf(stage, x(place), y(place))).join("")}</svg>`;
}
