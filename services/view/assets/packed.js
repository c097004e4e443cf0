"use strict";
// Numbers as bytes: zigzag varints of up to 53 bits, and the last ticks of the live page in this form.

// A reader of zigzag varints; see scrub.rs.
class Varints {
  constructor(bytes, at, end) { Object.assign(this, { bytes, at, end }); }
  next() {
    let byte = this.bytes[this.at++];
    if (byte < 128) return byte & 1 ? -(byte + 1) / 2 : byte / 2;
    let value = byte & 0x7f;
    for (let scale = 128; byte & 0x80; scale *= 128) {
      byte = this.bytes[this.at++];
      value += (byte & 0x7f) * scale;
    }
    return value % 2 ? -(value + 1) / 2 : value / 2;
  }
  list() {
    return Array.from({ length: this.next() }, () => this.next());
  }
  // A list x, y, x, y, … from second differences.
  path() {
    const points = [];
    let [x, y, vx, vy] = [0, 0, 0, 0];
    for (let step = this.next(); step > 0; step--) {
      vx += this.next();
      vy += this.next();
      x += vx;
      y += vy;
      points.push(x, y);
    }
    return points;
  }
  text() {
    const length = this.next();
    const bytes = this.bytes.subarray(this.at, this.at + length);
    this.at += length;
    return String.fromCharCode(...bytes);
  }
}

class Writer {
  constructor() {
    this.bytes = new Uint8Array(1 << 16);
    this.at = 0;
  }
  put(value) {
    if (this.at + 10 > this.bytes.length) {
      const larger = new Uint8Array(2 * this.bytes.length);
      larger.set(this.bytes);
      this.bytes = larger;
    }
    let rest = value < 0 ? -2 * value - 1 : 2 * value;
    while (rest > 0x7fffffff) {
      this.bytes[this.at++] = rest % 128 | 128;
      rest = Math.floor(rest / 128);
    }
    while (rest >= 128) {
      this.bytes[this.at++] = rest & 127 | 128;
      rest >>= 7;
    }
    this.bytes[this.at++] = rest;
  }
  list(values) {
    this.put(values.length);
    for (const value of values) this.put(value);
  }
  path(points) {
    this.put(points.length / 2);
    let [x, y, vx, vy] = [0, 0, 0, 0];
    for (let at = 0; at < points.length; at += 2) {
      const [dx, dy] = [points[at] - x, points[at + 1] - y];
      this.put(dx - vx);
      this.put(dy - vy);
      [x, y, vx, vy] = [points[at], points[at + 1], dx, dy];
    }
  }
}

// How long the page remembers, in seconds of the recording, and in bytes. The first limit that is reached counts.
const KEPT_S = 120;
const KEPT_BYTES = 128 << 20;
// Bytes of a kept tick and of one of its agents besides the packed numbers.
const TICK_BYTES = 400;
const AGENT_BYTES = 12;
// The error of a forecast is measured this many seconds after the forecast.
const ERROR_S = 2;
// No error: the agent has no forecast of that time.
const NONE = -1;

// The last ticks. Each has an ordinal, which counts the received ticks.
class Ring {
  constructor(seconds = KEPT_S, bytes = KEPT_BYTES) {
    Object.assign(this, { seconds, bytesMax: bytes, ticks: [], first: 0, bytes: 0 });
    this.writer = new Writer();
    this.known = new Map(); // by track: names, and sums of errors
    this.unpacked = { ordinal: -1, scene: null };
  }

  get newest() { return this.first + this.ticks.length - 1; }
  tick(ordinal) { return this.ticks[ordinal - this.first]; }

  // Keeps a scene, and gives its agents their errors. Returns the kept tick.
  push(scene) {
    const last = this.ticks[this.ticks.length - 1];
    // Stamps may jump. Time on the page's own axis does not.
    const s = last ? last.s + Math.min(Math.max(scene.t - last.t, 0), 2) : 0;
    const tick = { seq: scene.seq, t: scene.t, s, dt: scene.dt, ego: scene.ego, latency: scene.l, starts: scene.r || {},
                   doubts: scene.d || 0, counts: LOOKS.map(() => 0), marks: [], ids: [], places: null, foreseen: 0, bytes: null };
    this.measure(scene);
    this.writer.at = 0;
    tick.places = Uint32Array.from(scene.agents, (agent) => {
      const known = this.known.get(agent.i);
      known.ordinal = this.newest + 1;
      tick.ids.push(known.i);
      if (agent.f) tick.counts[agent.f.c] = (tick.counts[agent.f.c] || 0) + 1;
      const place = this.writer.at;
      this.pack(agent);
      return place;
    });
    tick.foreseen = this.writer.at;
    this.writer.list(scene.g || []);
    this.writer.list((scene.k || []).flat());
    tick.bytes = this.writer.bytes.slice(0, this.writer.at);
    this.ticks.push(tick);
    this.bytes += this.sizeOf(tick);
    while (this.ticks.length > 1 && (this.ticks[0].s < s - this.seconds || this.bytes > this.bytesMax)) {
      this.bytes -= this.sizeOf(this.ticks.shift());
      this.first++;
    }
    if (this.known.size > 2 * scene.agents.length + 64) {
      for (const [id, { ordinal }] of this.known) if (ordinal < this.first) this.known.delete(id);
    }
    this.unpacked = { ordinal: this.newest, scene };
    return tick;
  }

  sizeOf(tick) { return tick.bytes.length + AGENT_BYTES * tick.ids.length + TICK_BYTES; }

  // Measures the errors of the forecasts of ERROR_S ago, and their means so far.
  measure(scene) {
    const earlier = this.nearest(scene.t - ERROR_S, 0.25);
    const places = earlier && new Map(earlier.ids.map((id, place) => [id, place]));
    for (const agent of scene.agents) {
      let known = this.known.get(agent.i);
      if (!known) {
        known = { i: agent.i, n: agent.n, sum: 0, steadySum: 0, count: 0, ordinal: 0 };
        this.known.set(agent.i, known);
      }
      const place = places && places.get(agent.i);
      const errors = place !== undefined && places ? errorsOf(earlier, this.agent(earlier, place), scene.t - earlier.t, agent.p) : null;
      [agent.error, agent.steady] = errors || [NONE, NONE];
      if (errors) {
        known.sum += errors[0];
        known.steadySum += errors[1];
        known.count++;
      }
      agent.meanError = known.count ? Math.round(known.sum / known.count) : NONE;
      agent.meanSteady = known.count ? Math.round(known.steadySum / known.count) : NONE;
    }
  }

  // The kept tick at a time of the recording, to within `slack` seconds.
  nearest(t, slack) {
    let best = null;
    for (let place = this.ticks.length - 1; place >= 0; place--) {
      const apart = Math.abs(this.ticks[place].t - t);
      if (apart <= slack && (!best || apart < Math.abs(best.t - t))) best = this.ticks[place];
      else if (best) break;
    }
    return best;
  }

  pack({ p, v, h, s, u, t, y, f, error, steady, meanError, meanSteady }) {
    const { writer } = this;
    for (const value of [...p, t, error, steady, meanError, meanSteady, ...v, h, ...s, u]) writer.put(value);
    writer.put(f ? 4 * f.c + f.q : NONE);
    if (f) {
      writer.put(f.a);
      writer.put(f.o);
      writer.path(f.b);
    }
    // From here on, what only a whole scene needs.
    writer.list(y.map((value) => (value === null ? 0 : value < 0 ? value : value + 1)));
    if (!f) return;
    writer.put(f.m.length);
    for (const [probability, points] of f.m) {
      writer.put(probability);
      writer.path(points);
    }
    writer.list(f.e.flat());
    writer.list(f.x);
  }

  // The agent at a place of a tick, without or with history and modes.
  agent(tick, place, isWhole = false) {
    const from = new Varints(tick.bytes, tick.places[place], tick.bytes.length);
    const id = tick.ids[place];
    const known = this.known.get(id);
    const p = [from.next(), from.next()];
    const [t, error, steady, meanError, meanSteady] = [from.next(), from.next(), from.next(), from.next(), from.next()];
    const agent = { i: id, n: known ? known.n : id, p, t, error, steady, meanError, meanSteady,
                    v: [from.next(), from.next()], h: from.next(), s: [from.next(), from.next()], u: from.next() };
    const kind = from.next();
    if (kind >= 0) agent.f = { q: kind % 4, c: Math.floor(kind / 4), a: from.next(), o: from.next(), b: from.path() };
    if (!isWhole) return agent;
    agent.y = from.list().map((value) => (value === 0 ? null : value < 0 ? value : value - 1));
    if (!agent.f) return agent;
    agent.f.m = Array.from({ length: from.next() }, () => [from.next(), from.path()]);
    const mixture = from.list();
    agent.f.e = Array.from({ length: mixture.length / 6 }, (_, k) => mixture.slice(6 * k, 6 * k + 6));
    agent.f.x = from.list();
    return agent;
  }

  // The scene of a kept tick.
  scene(ordinal) {
    if (this.unpacked.ordinal !== ordinal) {
      const tick = this.tick(ordinal);
      const agents = tick.ids.map((_, place) => this.agent(tick, place, true));
      const { seq, t, dt, ego, latency: l } = tick;
      const from = new Varints(tick.bytes, tick.foreseen, tick.bytes.length);
      const [g, numbers] = [from.list(), from.list()];
      const k = Array.from({ length: numbers.length / 7 }, (_, place) => numbers.slice(7 * place, 7 * place + 7));
      this.unpacked = { ordinal, scene: { seq, t, dt, ego, l, agents, g, k } };
    }
    return this.unpacked.scene;
  }

  // An agent at each kept tick of a range of ordinals, as [tick, agent].
  series(id, from = this.first, to = this.newest) {
    const found = [];
    for (let ordinal = Math.max(from, this.first); ordinal <= Math.min(to, this.newest); ordinal++) {
      const tick = this.tick(ordinal);
      const place = tick.ids.indexOf(id);
      if (place >= 0) found.push([tick, this.agent(tick, place)]);
    }
    return found;
  }

  // Where each agent of a tick was tracked later, up to the end of the horizon: by track, x, y, x, y, …
  later(ordinal) {
    const begin = this.tick(ordinal);
    const scene = this.scene(ordinal);
    const steps = Math.max(0, ...scene.agents.map(({ f }) => (f ? f.b.length / 2 : 0)));
    const paths = new Map(scene.agents.map(({ i, p }) => [i, [...p]]));
    for (let at = ordinal + 1; at <= this.newest; at++) {
      const tick = this.tick(at);
      if (tick.t > begin.t + steps * begin.dt + 1e-6 || tick.t < begin.t) break;
      tick.ids.forEach((id, place) => {
        const path = paths.get(id);
        if (!path) return;
        const from = new Varints(tick.bytes, tick.places[place], tick.bytes.length);
        path.push(from.next(), from.next());
      });
    }
    return paths;
  }
}

// The distances in cm between a position and where it was expected: published, and at constant velocity.
function errorsOf({ dt }, { p, v, f }, ahead, now) {
  if (!f || !f.b.length) return null;
  const at = ahead / dt - 1; // place between the steps
  const [low, share] = [Math.floor(at), at - Math.floor(at)];
  const isBetween = share > 1e-6;
  const step = (k, axis) => (k < 0 ? 0 : f.b[2 * k + axis]);
  if (2 * (low + (isBetween ? 1 : 0)) + 1 >= f.b.length) return null;
  const apart = (point) => Math.round(Math.hypot(point[0] - now[0], point[1] - now[1]));
  return [
    apart([0, 1].map((axis) => p[axis] + step(low, axis) + (isBetween ? (step(low + 1, axis) - step(low, axis)) * share : 0))),
    apart([0, 1].map((axis) => p[axis] + v[axis] * ahead)),
  ];
}
