"use strict";
// The pipeline as a graph: a box for each stage with its compute against the budget, an arrow for each topic with waiting,
// wake-up and losses of the stage that it leads to, and dashed boxes for other computers, ROS and the publication. Boxes
// fill rows, as wide as the page permits.

const BOX = { width: 146, height: 66, gap: 84 };
// Height of a line of words beside an arrow.
const LINE = 12;
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
    const link = { reads: isInput ? [] : ["out"], writes: isInput ? ["in"] : [], isOutput: !isInput, since: stage.since_stamp_ms };
    const [reads, writes] = [[...(stage.reads || []), ...link.writes], [...(stage.writes || []), ...link.reads]];
    const pair = [{ ...partner, ...link }, { ...stage, reads, writes }];
    return isInput ? pair : pair.reverse();
  });
  if (since && since.p50 !== null) {
    const lines = [`${pairOf(since)} ms`, "since the stamp"];
    boxes.push({ name: "publication", partner: true, lines, reads: ["forecasts"], writes: [] });
  }
  return boxes;
}

// The arrows between boxes, from producer to consumer. `back` leads to an earlier stage of the next tick. The last arrow on
// the way of a tick into a stage has the stage's waiting, wake-up and losses.
function arrowsOf(boxes) {
  const arrows = boxes.flatMap((producer, from) => (producer.writes || []).flatMap((topic) =>
    boxes.map((consumer, to) => [consumer, to]).filter(([consumer]) => (consumer.reads || []).includes(topic))
      .map(([, to]) => ({ from, to, topic, back: to <= from, times: [], lost: 0 }))));
  boxes.forEach((stage, place) => {
    if (stage.since) arrows.filter(({ to }) => to === place).forEach((arrow) => { arrow.times = [["since stamp", pairOf(stage.since)]]; });
    const last = stage.drops && arrows.findLast(({ from, to, back }) => to === place && !back && !boxes[from].partner);
    if (!last) return;
    last.lost = lostBefore(stage);
    if (stage.compute_ms.p50 !== null) last.times = [["waiting", pairOf(stage.waiting_ms)], ["wake-up", pairOf(stage.wake_up_ms)]];
    stage.hasEntry = true;
  });
  return arrows;
}

// Frames that did not arrive at a stage, or that it refused.
const lostBefore = ({ drops }) => drops.gap + drops.refused;

// The lines of words beside an arrow, each with its colour.
const wordsBeside = ({ topic, times, lost }) => [[topic, lost ? "bad" : "soft"], ...times.flat().map((words) => [words, "soft"]), ...(lost ? [[`${lost} lost`, "bad"]] : [])];

// Two numbers in ms.
const pairOf = ({ p50, p99 }) => `${shortNumber(p50)} / ${shortNumber(p99)}`;

function boxOf(stage, [x, y]) {
  const text = (at, words, tone, more = "") => `<text x="8" y="${at}" fill="var(--${tone})"${more}>${words}</text>`;
  const name = text(17, escaped(stage.name), "ink", ' font-weight="600"');
  const outline = (tone, dash) => `<rect width="${BOX.width}" height="${BOX.height}" rx="8" fill="var(--panel)" stroke="var(--${tone})"${dash}/>`;
  const group = (content, of) => `<g transform="translate(${x} ${y})" ${of}="${escaped(stage.name)}">${content}</g>`;
  if (stage.partner) {
    const lines = stage.lines.map((line, place) => text(33 + 13 * place, line, stage.isFaulty && place === stage.lines.length - 1 ? "bad" : "soft"));
    return group(outline(stage.isFaulty ? "bad" : "faint", ' stroke-dasharray="4 3"') + name + lines.join(""), "data-partner");
  }
  const { budget_ms: budget, compute_ms: compute } = stage;
  const over = budget && compute.p99 > budget;
  const lost = stage.drops.restart + (stage.hasEntry ? 0 : lostBefore(stage));
  const share = (value) => (BOX.width - 16) * Math.min((value || 0) / budget, 1);
  const bar = (value, tone, opacity) => `<rect x="8" y="39" width="${share(value).toFixed(1)}" height="5" rx="2" fill="var(--${tone})" opacity="${opacity}"/>`;
  const bars = budget ? `<rect x="8" y="39" width="${BOX.width - 16}" height="5" rx="2" fill="var(--line)"/>` +
    bar(compute.p99, over ? "bad" : "accent", 0.4) + bar(compute.p50, over ? "bad" : "accent", 1) : "";
  const faults = [stage.restarts && `${stage.restarts} restart${stage.restarts > 1 ? "s" : ""}`, lost && `${lost} lost`].filter(Boolean).join(", ");
  const isMeasured = compute.p50 !== null;
  const lines = isMeasured ? text(33, `${pairOf(compute)}${budget ? ` of ${shortNumber(budget)}` : ""} ms`, over ? "bad" : "soft") + bars :
    text(33, escaped(stage.program || ""), "soft");
  return group(`<title>${escaped(stage.name)}${isMeasured ? `: compute ${pairOf(compute)} ms${budget ? ` of ${budget} ms` : ""}, waiting ` +
    `${pairOf(stage.waiting_ms)}, wake-up ${pairOf(stage.wake_up_ms)} (p50 / p99)` : ""}</title>` +
    outline(faults || over ? "bad" : "line", "") + name + lines + (faults && text(59, faults, "bad")), "data-stage");
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
  const needs = (isLeft) => {
    const passing = far.filter((of) => of.isFar && of.isLeft === isLeft).length;
    return passing ? 8 + 7 * passing + beside : 4;
  };
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
  // In a column, the words of a straight arrow are beside it, between the lanes of arrows that leave and enter.
  const isColumn = columns === 1;
  const wordsIn = (row) => (isColumn && row && row < rows ? Math.max(...arrows.filter((arrow) => isStraight(arrow) && places[arrow.to].row === row).map((arrow) => LINE * wordsBeside(arrow).length + 8), 0) : 0);
  // The words of losses are below the box.
  const below = isColumn || !arrows.some((arrow) => isNear(arrow) && arrow.lost) ? 0 : LINE;
  const tops = [];
  let y = 2;
  for (let row = 0; row < rows; row++) {
    y += wordsIn(row) + (levels[row] ? CHANNEL.least + CHANNEL.each * levels[row] : row && !wordsIn(row) ? CHANNEL.least : 0);
    tops.push(y);
    y += BOX.height + below;
  }
  const height = y + (levels[rows] ? CHANNEL.least / 2 + CHANNEL.each * levels[rows] : 2);
  const corner = ({ column, row }) => [left + column * (BOX.width + BOX.gap), tops[row]];
  const levelOf = (channel, number) => (channel < rows ? tops[channel] - 15 - CHANNEL.each * number : tops[rows - 1] + BOX.height + below + 13 + CHANNEL.each * number);
  const HALO = ' stroke="var(--panel)" stroke-width="3" paint-order="stroke"';
  const label = ([words, tone], [x, at], anchor = "middle", halo = "") => `<text x="${x}" y="${at}" text-anchor="${anchor}" fill="var(--${tone})"${halo}>${escaped(words)}</text>`;
  const stack = (all, [x, at], anchor, halo) => all.map((words, place) => label(words, [x, at + LINE * place], anchor, halo)).join("");
  // Words on a line. They cover it.
  const onLine = ({ topic, times, lost }, [x, at]) => {
    const others = [...times.map((words) => words.join(" ")), lost && `${lost} lost`].filter(Boolean).join(", ");
    const words = others ? `${topic}: ${others}` : topic;
    return `<rect x="${x - 3 * words.length}" y="${at - 10}" width="${6 * words.length}" height="13" fill="var(--panel)"/>${label([words, lost ? "bad" : "soft"], [x, at])}`;
  };
  // Words beside lines at a side must not cover each other.
  const taken = { true: [], false: [] };
  const freeFrom = (at, height, isLeft) => {
    const other = taken[isLeft].find(([top, bottom]) => at < bottom && at + height > top);
    if (other) return freeFrom(other[1], height, isLeft);
    taken[isLeft].push([at, at + height]);
    return at;
  };
  const line = (points, { back, lost, topic }) => `<path d="${points}" data-topic="${escaped(topic)}" fill="none" stroke="var(--${lost ? "bad" : "soft"})" marker-end="url(#tip${lost ? "-bad" : ""})"${back ? ' stroke-dasharray="4 3"' : ""}/>`;
  const near = arrows.filter((arrow) => isNear(arrow) || isStraight(arrow)).map((arrow) => {
    const [[ax, ay], [bx, by]] = [corner(places[arrow.from]), corner(places[arrow.to])];
    if (isStraight(arrow)) {
      const middle = ax + BOX.width * 0.3;
      return line(`M${middle} ${ay + BOX.height}V${by - 2}`, arrow) + stack(wordsBeside(arrow), [middle + 6, ay + BOX.height + 12], "start");
    }
    const [topic, ...others] = wordsBeside(arrow);
    const [middle, at] = [(ax + BOX.width + bx) / 2, ay + 15];
    return line(`M${ax + BOX.width} ${at}H${bx - 2}`, arrow) + label(topic, [middle, at - 5]) + stack(others, [middle, at + 13]);
  });
  const passing = { true: 0, false: 0 };
  const routed = far.map((of, number) => {
    const [[ax, ay], [bx, by]] = [corner(places[of.from]), corner(places[of.to])];
    const [start, end] = [ax + BOX.width * (isColumn ? 0.8 : 0.62) + 6 * (number % 5), bx + BOX.width * (isColumn ? 0.04 : 0.14) + 6 * (number % 5)];
    const [leave, enter] = [of.isBelow ? ay + BOX.height : ay, of.isAbove ? by - 2 : by + BOX.height + 2];
    const [first, last] = [levelOf(of.first, of.levels[0]), of.isFar ? levelOf(of.last, of.levels[1]) : 0];
    const before = of.isFar ? passing[of.isLeft]++ : 0;
    const side = of.isLeft ? left - 8 - 7 * before : left + inside + 8 + 7 * before;
    const way = of.isFar ? `V${first}H${side}V${last}H${end}V${enter}` : `V${first}H${end}V${enter}`;
    if (beside && of.isFar) {
      const all = wordsBeside(of);
      const at = freeFrom((first + last) / 2, LINE * all.length + 4, of.isLeft);
      return [line(`M${start} ${leave}${way}`, of), stack(all, [side + (of.isLeft ? -5 : 5), at], of.isLeft ? "end" : "start", HALO)];
    }
    return [line(`M${start} ${leave}${way}`, of), onLine(of, of.isFar ? [(side + end) / 2, last + 4] : [(start + end) / 2, first + 4])];
  });
  const tip = (id, tone) => `<marker id="tip${id}" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto"><path d="M0 0L8 4L0 8Z" fill="var(--${tone})"/></marker>`;
  return `<svg class="pipeline" viewBox="0 0 ${left + inside + right} ${height}" style="width:${left + inside + right}px;max-width:100%;display:block" font-size="11.5" role="img" aria-label="Stages and topics">` +
    `<defs>${tip("", "soft")}${tip("-bad", "bad")}</defs>` +
    `${routed.map(([path]) => path).join("")}${near.join("")}${boxes.map((stage, place) => boxOf(stage, corner(places[place]))).join("")}${routed.map(([, words]) => words).join("")}</svg>`;
}
