"use strict";
// The pipeline as a graph: a box for each stage with its times against the budget, an arrow for each topic, and dashed
// boxes for other computers, ROS and the publication. Boxes fill rows, as wide as the page permits.

const BOX = { width: 146, height: 78, gap: 66 };
// Space between rows, besides that for its arrows; and for each arrow.
const CHANNEL = { least: 16, each: 17 };

// The boxes of a report in the order in which a tick passes them. `partner` is outside of the run.
function boxesOf({ stages, links = {}, since_stamp_ms: since }) {
  const boxes = stages.flatMap((stage) => {
    const words = PARTNERS[stage.program];
    if (!words) return [stage];
    const { frames, ...faults } = { ...links[stage.name] };
    const [lost, skipped] = [faults.lost, faults.skipped];
    const lines = [frames && `${frames.toLocaleString("en")} frames`, skipped && `${skipped} skipped`, lost && `${lost} ${lost === 1 ? "link" : "links"} lost`].filter(Boolean);
    const partner = { name: words, partner: true, lines, isFaulty: Boolean(lost) };
    const isInput = stage.name === "source";
    const link = { reads: isInput ? [] : ["out"], writes: isInput ? ["in"] : [], isOutput: !isInput };
    const [reads, writes] = [[...(stage.reads || []), ...link.writes], [...(stage.writes || []), ...link.reads]];
    const pair = [{ ...partner, ...link }, { ...stage, reads, writes }];
    return isInput ? pair : pair.reverse();
  });
  if (since && since.p50 !== null) {
    const lines = ["since the stamp", `${pairOf(since)} ms`];
    boxes.push({ name: "publication", partner: true, lines, reads: ["forecasts"], writes: [] });
  }
  return boxes;
}

// The arrows between boxes, from producer to consumer. `back` leads to an earlier stage of the next tick.
function arrowsOf(boxes) {
  return boxes.flatMap((producer, from) => (producer.writes || []).flatMap((topic) =>
    boxes.map((consumer, to) => [consumer, to]).filter(([consumer]) => (consumer.reads || []).includes(topic))
      .map(([, to]) => ({ from, to, topic, back: to <= from }))));
}

// Two numbers in ms.
const pairOf = ({ p50, p99 }) => `${shortNumber(p50)} / ${shortNumber(p99)}`;

function boxOf(stage, [x, y]) {
  const text = (at, words, tone, more = "") => `<text x="8" y="${at}" fill="var(--${tone})"${more}>${words}</text>`;
  const name = text(17, escaped(stage.name), "ink", ' font-weight="600"');
  const outline = (tone, dash) => `<rect width="${BOX.width}" height="${BOX.height}" rx="8" fill="var(--panel)" stroke="var(--${tone})"${dash}/>`;
  const group = (content, of) => `<g transform="translate(${x} ${y})" ${of}="${escaped(stage.name)}">${content}</g>`;
  if (stage.partner) {
    const lines = stage.lines.map((line, place) => text(36 + 15 * place, line, stage.isFaulty && place === stage.lines.length - 1 ? "bad" : "soft"));
    return group(outline(stage.isFaulty ? "bad" : "faint", ' stroke-dasharray="4 3"') + name + lines.join(""), "data-partner");
  }
  const { budget_ms: budget, compute_ms: compute } = stage;
  const over = budget && compute.p99 > budget;
  const lost = stage.drops.gap + stage.drops.refused + stage.drops.restart;
  const share = (value) => (BOX.width - 16) * Math.min((value || 0) / budget, 1);
  const bar = (value, tone, opacity) => `<rect x="8" y="36" width="${share(value).toFixed(1)}" height="5" rx="2" fill="var(--${tone})" opacity="${opacity}"/>`;
  const bars = budget ? `<rect x="8" y="36" width="${BOX.width - 16}" height="5" rx="2" fill="var(--line)"/>` +
    bar(compute.p99, over ? "bad" : "accent", 0.4) + bar(compute.p50, over ? "bad" : "accent", 1) : "";
  const faults = [lost && `${lost} lost`, stage.restarts && `${stage.restarts} restart${stage.restarts > 1 ? "s" : ""}`].filter(Boolean);
  const isMeasured = compute.p50 !== null;
  const lines = isMeasured ? text(31, `${pairOf(compute)}${budget ? ` of ${shortNumber(budget)}` : ""} ms`, over ? "bad" : "soft") + bars +
    text(55, `waiting ${pairOf(stage.waiting_ms)}`, "soft") + text(70, `wake-up ${pairOf(stage.wake_up_ms)}`, "soft") :
    text(36, escaped(stage.program || ""), "soft");
  return group(`<title>${escaped(stage.name)}${isMeasured ? `: compute ${pairOf(compute)} ms${budget ? ` of ${budget} ms` : ""}, waiting ` +
    `${pairOf(stage.waiting_ms)}, wake-up ${pairOf(stage.wake_up_ms)} (p50 / p99)` : ""}</title>` +
    outline(faults.length || over ? "bad" : "line", "") + name +
    `<text x="${BOX.width - 8}" y="17" text-anchor="end" fill="var(--bad)">${faults.join(", ")}</text>${lines}`, "data-stage");
}

// The places of boxes in rows of at most `columns`: each stage after the ones that it reads from, and a partner beside
// its stage.
function placesOf(boxes, arrows, columns) {
  const depth = boxes.map(() => 0);
  boxes.forEach((_, to) => arrows.filter((arrow) => arrow.to === to && !arrow.back)
    .forEach(({ from }) => { depth[to] = Math.max(depth[to], depth[from] + (boxes[to].isOutput ? 0 : 1)); }));
  const order = boxes.map((_, place) => place).sort((a, b) => depth[a] - depth[b] || a - b);
  const places = [];
  order.forEach((box, at) => { places[box] = { at, column: at % columns, row: Math.floor(at / columns) }; });
  return places;
}

// The way of an arrow that does not lead to the next box of its row: out of a side, along channels, into a side.
// Channel k lies above row k. Far rows are passed at the left (back) or right.
function wayOf(a, b) {
  const [leaves, enters] = [b.row > a.row || (b.row === a.row && a.at > b.at), b.row > a.row || (b.row === a.row && a.at < b.at)];
  const first = leaves ? a.row + 1 : a.row;
  const last = enters ? b.row : b.row + 1;
  return { first, last, isBelow: leaves, isAbove: enters, isFar: first !== last, isLeft: b.row < a.row };
}

// The graph of a report as SVG for a width in pixels; nothing if the report does not have the stages' topics.
function graphOf(report, width) {
  const boxes = boxesOf(report);
  const arrows = arrowsOf(boxes);
  if (!arrows.length) return "";
  const margin = 8 + 7 * arrows.length;
  let columns = Math.max(Math.floor((width + BOX.gap - 8) / (BOX.width + BOX.gap)), 1);
  // Rows are about equally long.
  columns = Math.ceil(boxes.length / Math.ceil(boxes.length / columns));
  let places = placesOf(boxes, arrows, columns);
  const isNear = ({ from, to }) => places[to].row === places[from].row && places[to].column === places[from].column + 1;
  const isStraight = ({ from, to }) => columns === 1 && places[to].row === places[from].row + 1;
  const routes = () => arrows.filter((arrow) => !isNear(arrow) && !isStraight(arrow))
    .map((arrow) => ({ ...arrow, ...wayOf(places[arrow.from], places[arrow.to]) }));
  let far = routes();
  // In a column, words are beside the lines.
  const beside = columns === 1 ? 66 : 0;
  const needs = (isLeft) => (far.some((of) => of.isFar && of.isLeft === isLeft) ? margin + beside : 4);
  // Arrows that pass rows need room at the sides.
  if (columns > 1 && needs(true) + needs(false) + columns * (BOX.width + BOX.gap) - BOX.gap > width) {
    columns--;
    places = placesOf(boxes, arrows, columns);
    far = routes();
  }
  const rows = Math.max(...places.map(({ row }) => row)) + 1;
  const [left, right] = [needs(true), needs(false)];
  const inside = Math.min(columns, boxes.length) * (BOX.width + BOX.gap) - BOX.gap;
  const levels = Array.from({ length: rows + 1 }, () => 0);
  for (const of of far) {
    of.levels = [of.first, ...(of.isFar ? [of.last] : [])].map((channel) => levels[channel]++);
  }
  const straightRows = columns === 1 ? 10 : 0;
  const tops = [];
  let y = 2;
  for (let row = 0; row < rows; row++) {
    y += levels[row] ? CHANNEL.least + CHANNEL.each * levels[row] : row ? CHANNEL.least + straightRows : 0;
    tops.push(y);
    y += BOX.height;
  }
  const height = y + (levels[rows] ? CHANNEL.least / 2 + CHANNEL.each * levels[rows] : 2);
  const corner = ({ column, row }) => [left + column * (BOX.width + BOX.gap), tops[row]];
  const levelOf = (channel, number) => (channel < rows ? tops[channel] - 15 - CHANNEL.each * number : tops[rows - 1] + BOX.height + 13 + CHANNEL.each * number);
  const label = (topic, [x, at], anchor = "middle") => `<text x="${x}" y="${at}" text-anchor="${anchor}" fill="var(--soft)" stroke="var(--panel)" stroke-width="4" paint-order="stroke">${escaped(topic)}</text>`;
  const line = (points, dash) => `<path d="${points}" fill="none" stroke="var(--soft)" marker-end="url(#tip)"${dash ? ' stroke-dasharray="4 3"' : ""}/>`;
  const near = arrows.filter((arrow) => isNear(arrow) || isStraight(arrow)).map((arrow) => {
    const [[ax, ay], [bx, by]] = [corner(places[arrow.from]), corner(places[arrow.to])];
    if (isStraight(arrow)) {
      const middle = ax + BOX.width / 2;
      return line(`M${middle} ${ay + BOX.height}V${by - 2}`, false) + label(arrow.topic, [middle - 6, (ay + BOX.height + by) / 2 + 3], "end");
    }
    return line(`M${ax + BOX.width} ${ay + BOX.height / 2}H${bx - 2}`, false) + label(arrow.topic, [(ax + BOX.width + bx) / 2, ay + BOX.height / 2 - 6]);
  });
  let passing = 0;
  const routed = far.map((of, number) => {
    const [[ax, ay], [bx, by]] = [corner(places[of.from]), corner(places[of.to])];
    const [start, end] = [ax + BOX.width * 0.62 + 6 * (number % 7), bx + BOX.width * 0.14 + 6 * (number % 7)];
    const [leave, enter] = [of.isBelow ? ay + BOX.height : ay, of.isAbove ? by - 2 : by + BOX.height + 2];
    const [first, last] = [levelOf(of.first, of.levels[0]), of.isFar ? levelOf(of.last, of.levels[1]) : 0];
    const side = of.isLeft ? left - 8 - 7 * passing : left + inside + 8 + 7 * passing;
    passing += of.isFar ? 1 : 0;
    const way = of.isFar ? `V${first}H${side}V${last}H${end}V${enter}` : `V${first}H${end}V${enter}`;
    const words = beside && of.isFar ? label(of.topic, [side + (of.isLeft ? -5 : 5), (first + last) / 2 + 16 * passing], of.isLeft ? "end" : "start") :
      label(of.topic, of.isFar ? [(side + end) / 2, last + 4] : [(start + end) / 2, first + 4]);
    return [line(`M${start} ${leave}${way}`, of.back), words];
  });
  return `<svg class="pipeline" viewBox="0 0 ${left + inside + right} ${height}" style="width:${left + inside + right}px;max-width:100%;display:block" font-size="11.5" role="img" aria-label="Stages and topics">` +
    `<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto"><path d="M0 0L8 4L0 8Z" fill="var(--soft)"/></marker></defs>` +
    `${routed.map(([path]) => path).join("")}${near.join("")}${boxes.map((stage, place) => boxOf(stage, corner(places[place]))).join("")}${routed.map(([, words]) => words).join("")}</svg>`;
}
