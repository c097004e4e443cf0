"use strict";
// Conflicts: pairs of agents whose forecasts meet, as the crate `conflicts` computes them, from the probable modes. An
// outline is three circles along the agent, one for a pedestrian; the gap of a pair is the smallest distance of the
// outlines. The odds of a conflict, CONFLICT_ODDS, are what recordings say of pairs with the same signs.

// Pairs that are farther apart, or closer already, are left out. Lengths in cm.
const FAR_CM = 6000;
const TOUCHING_CM = 100;
// A gap below the first is a conflict, and below the second it is near.
const GAP_CM = 50;
const NEAR_CM = 200;
// A smaller probability has its logarithm.
const PROBABILITY_LEAST = 1e-4;
// Directions are the same or opposite up to an angle with this cosine.
const ALIKE = 0.7;
// An agent that is not faster stands, cm/s.
const STILL_CMPS = 50;
// Conflicts that the modes foretell with a smaller probability are not listed, and the most that are listed.
const CONFLICT_LEAST = 0.1;
const CONFLICTS_MAX = 8;
const TYPICAL_CM = [[450, 190], [180, 60], [60, 60]];

function sizeOf({ t, s }) {
  const typical = TYPICAL_CM[t] || TYPICAL_CM[2];
  return [s[0] || typical[0], s[1] || typical[1]];
}

// The circles' places along an agent, and their radius.
function outlineOf(agent) {
  if (agent.t === 2) return { along: [0], radius: 30, reach: 30 };
  const [length, width] = sizeOf(agent);
  const end = Math.max((length - width) / 2, 0);
  return { along: [0, -end, end], radius: width / 2, reach: end + width / 2 };
}

// Numbers of a pose: the places of an outline's circles, the middle one first.
const POSE = 6;

function putPose(poses, at, x, y, cos, sin, end) {
  poses.set([x, y, x + end * cos, y + end * sin, x - end * cos, y - end * sin], at);
}

// An agent's probable modes as poses by step, after the present one, and the box around them.
function movesOf(agent) {
  const probable = agent.f.m.filter(([p]) => p >= IMPROBABLE);
  const modes = probable.length ? probable : [[1000, agent.f.b]];
  const total = modes.reduce((sum, [p]) => sum + p, 0);
  const outline = outlineOf(agent);
  const end = outline.along[outline.along.length - 1];
  const box = [agent.p[0], agent.p[1], agent.p[0], agent.p[1]];
  const moves = modes.map(([p, points]) => {
    const poses = new Float64Array(POSE * (points.length / 2 + 1));
    let [x, y, cos, sin] = [agent.p[0], agent.p[1], Math.cos(agent.h / 1000), Math.sin(agent.h / 1000)];
    putPose(poses, 0, x, y, cos, sin, end);
    for (let at = 0; at < points.length; at += 2) {
      const [nx, ny] = [agent.p[0] + points[at], agent.p[1] + points[at + 1]];
      const length = Math.hypot(nx - x, ny - y);
      // Slower agents keep their heading.
      if (length > 10) [cos, sin] = [(nx - x) / length, (ny - y) / length];
      putPose(poses, (at / 2 + 1) * POSE, nx, ny, cos, sin, end);
      [x, y] = [nx, ny];
      [box[0], box[1], box[2], box[3]] = [Math.min(box[0], x), Math.min(box[1], y), Math.max(box[2], x), Math.max(box[3], y)];
    }
    return { p: p / total, poses };
  });
  return { agent, moves, box, outline, speed: Math.hypot(...agent.v) };
}

// The gap of two outlines at the same step; a lower bound if they are far apart.
function gapOf(a, b, at, first, second) {
  const [dx, dy] = [a[at] - b[at], a[at + 1] - b[at + 1]];
  const far = first.reach + second.reach + 6 * GAP_CM;
  if (dx * dx + dy * dy > far * far) return 6 * GAP_CM;
  let least = Infinity;
  for (let i = 0; i < 2 * first.along.length; i += 2) {
    for (let j = 0; j < 2 * second.along.length; j += 2) {
      const [x, y] = [a[at + i] - b[at + j], a[at + i + 1] - b[at + j + 1]];
      least = Math.min(least, x * x + y * y);
    }
  }
  return Math.sqrt(least) - first.radius - second.radius;
}

// The odds of a conflict as a probability: `until` a quarter, half and all of the horizon, and that of nearness.
function probabilityOf(one, other, until, near) {
  const walk = [one, other].filter(({ agent }) => agent.t === 2).length;
  const cosine = Math.cos((one.agent.h - other.agent.h) / 1000);
  const signs = [...until, near].map((p) => Math.log(Math.max(p, PROBABILITY_LEAST)));
  signs.push(Math.min(one.speed, other.speed) <= STILL_CMPS, walk === 1, walk === 2, cosine > ALIKE, cosine < -ALIKE);
  const logit = signs.reduce((sum, sign, at) => sum + CONFLICT_ODDS.weights[at] * sign, CONFLICT_ODDS.constant);
  return 1 / (1 + Math.exp(-logit));
}

// The conflict of a pair: its probability, that of the modes as if nobody reacted, time in s, and place in cm; null if there is none.
function conflictOf(one, other, dt) {
  const [first, second] = [one.outline, other.outline];
  if (Math.hypot(one.agent.p[0] - other.agent.p[0], one.agent.p[1] - other.agent.p[1]) > FAR_CM) return null;
  if (gapOf(one.moves[0].poses, other.moves[0].poses, 0, first, second) < TOUCHING_CM) return null;
  let [until, near, best, found] = [[0, 0, 0], 0, 0, null];
  for (const a of one.moves) {
    for (const b of other.moves) {
      const end = Math.min(a.poses.length, b.poses.length);
      let [least, begin] = [Infinity, 0];
      for (let at = POSE; at < end && !begin; at += POSE) {
        least = Math.min(least, gapOf(a.poses, b.poses, at, first, second));
        if (least < GAP_CM) begin = at / POSE;
      }
      const p = a.p * b.p;
      near += least < NEAR_CM ? p : 0;
      if (!begin) continue;
      const steps = end / POSE - 1;
      until = until.map((sum, part) => sum + (begin <= Math.ceil(steps / [4, 2, 1][part]) ? p : 0));
      if (p > best) {
        best = p;
        const middle = (axis) => (a.poses[begin * POSE + axis] + b.poses[begin * POSE + axis]) / 2;
        found = { t: begin * dt, x: middle(0), y: middle(1) };
      }
    }
  }
  return found && { ...found, p: probabilityOf(one, other, until, near), m: until[2] };
}

// The ego vehicle as an agent that keeps its speed and its rate of turn, from its pose `ago` seconds earlier.
function egoAgent(scene, before, ago) {
  if (!scene.ego || !before || !(ago > 0)) return null;
  const [x, y, heading] = scene.ego;
  const v = [(x - before[0]) / ago, (y - before[1]) / ago];
  const turned = Math.atan2(Math.sin(heading - before[2]), Math.cos(heading - before[2])) / ago;
  const speed = Math.hypot(...v) * Math.sign(v[0] * Math.cos(heading) + v[1] * Math.sin(heading) || 1);
  const steps = Math.max(12, ...scene.agents.map(({ f }) => (f ? f.b.length / 2 : 0)));
  const path = [];
  let [px, py, at] = [0, 0, heading];
  for (let step = 0; step < steps; step++) {
    at += turned * scene.dt / 2;
    px += speed * Math.cos(at) * scene.dt;
    py += speed * Math.sin(at) * scene.dt;
    at += turned * scene.dt / 2;
    path.push(px * 100, py * 100);
  }
  return { i: "ego", n: "ego", t: 0, p: [x * 100, y * 100], v: v.map((value) => value * 100), h: heading * 1000,
           s: [0, 0], f: { q: 2, c: 0, b: path, m: [] } };
}

// The conflicts of a scene, those of the ego vehicle first, then the most probable.
function conflictsOf(scene, ego) {
  const agents = scene.agents.filter(({ f }) => f && f.b.length).map(movesOf);
  if (ego) agents.unshift(movesOf(ego));
  const found = [];
  agents.forEach((one, place) => {
    for (const other of agents.slice(place + 1)) {
      if (Math.max(one.speed, other.speed) <= STILL_CMPS) continue;
      const slack = one.outline.reach + other.outline.reach + NEAR_CM;
      const isApart = [0, 1].some((axis) => one.box[axis] - slack > other.box[axis + 2] || other.box[axis] - slack > one.box[axis + 2]);
      const conflict = isApart ? null : conflictOf(one, other, scene.dt);
      if (conflict && conflict.m >= CONFLICT_LEAST) found.push({ ...conflict, a: one.agent, b: other.agent });
    }
  });
  const isEgo = ({ a }) => (a.i === "ego" ? 1 : 0);
  return found.sort((a, b) => isEgo(b) - isEgo(a) || b.p - a.p).slice(0, CONFLICTS_MAX);
}

// The distance in m of an agent from the ego vehicle's path, now or on its single best forecast at the same time.
function distanceFromPath(ego, { p, f }) {
  let least = Math.hypot(p[0] - ego.p[0], p[1] - ego.p[1]);
  for (let at = 0; at < ego.f.b.length; at += 2) {
    const [x, y] = [ego.p[0] + ego.f.b[at], ego.p[1] + ego.f.b[at + 1]];
    least = Math.min(least, Math.hypot(p[0] - x, p[1] - y));
    if (f && at < f.b.length) least = Math.min(least, Math.hypot(p[0] + f.b[at] - x, p[1] + f.b[at + 1] - y));
  }
  return least / 100;
}
