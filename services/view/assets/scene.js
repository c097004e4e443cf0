"use strict";
// Draws the scene of a tick on a canvas, with pan, zoom, pinch and picking. The live page and the report use it.
// A scene is what scene.rs writes: lengths in cm, positions of an agent relative to its own.

const TYPES = ["vehicle", "cyclist", "pedestrian"];
const QUALITIES = ["learned", "held", "kinematic"];
const PLURALS = ["vehicles", "cyclists", "pedestrians"];
const VERDICTS = { ok: ["OK", "good"], doubtful: ["DOUBTFUL", "warn"], degraded: ["DEGRADED", "bad"], empty: ["EMPTY", "warn"] };
// The layers of a scene that can be switched: name, words, and whether they are shown at first.
const LAYERS = [
  ["forecasts", "forecasts", true], ["modes", "modes", true], ["improbable", "modes below 2 %", false],
  ["regions", "regions", true], ["histories", "histories", true], ["lanes", "lanes", true],
  ["places", "places seen", true], ["truth", "where they went", false], ["conflicts", "conflicts", true],
];
// Modes with a smaller probability, in thousandths, belong to the layer "improbable".
const IMPROBABLE = 20;
const EXPERTS = ["network", "base", "constant velocity", "decaying turn", "process model",
                 "decaying acceleration", "following", "lane"];
// A pedestrian's, in the last two slots.
const EXPERTS_ON_FOOT = { 6: "standing", 7: "mean velocity" };

const root = document.documentElement;
const systemDark = matchMedia("(prefers-color-scheme: dark)");
root.dataset.theme = systemDark.matches ? "dark" : "light";

// The value of a style variable, so that canvases follow the theme.
function themed(name) {
  return getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
}

function palette() {
  const colors = {};
  for (const name of ["ground", "grid", "ink", "soft", "faint", "lane", "ego", "select", "unknown", "bad"]) {
    colors[name] = themed(name);
  }
  colors.cause = LOOKS.map(({ cause }) => themed("cause-" + cause));
  return colors;
}

function colorOf(colors, forecast) {
  return forecast ? colors.cause[forecast.c] || colors.unknown : colors.unknown;
}

// The modes of a mixture at the end of the horizon, for densities, and the box around three standard deviations.
function shapeOf(mixture) {
  const box = [Infinity, Infinity, -Infinity, -Infinity];
  const modes = [];
  for (const [p, x, y, xx, xy, yy] of mixture) {
    const determinant = xx * yy - xy * xy;
    if (!(determinant > 0) || p < 4) continue;
    const [sx, sy] = [3 * Math.sqrt(xx), 3 * Math.sqrt(yy)];
    [box[0], box[1]] = [Math.min(box[0], x - sx), Math.min(box[1], y - sy)];
    [box[2], box[3]] = [Math.max(box[2], x + sx), Math.max(box[3], y + sy)];
    modes.push([p / Math.sqrt(determinant), x, y, yy / determinant / 2, -xy / determinant, xx / determinant / 2, sx, sy]);
  }
  return { modes, box };
}

// The number of steps in which the level of a region is sought.
const BINS = 255;

// The density of a mixture on a grid, and the densities on the borders of its 50 % and 90 % highest-density regions.
// The border of the grid is 0, so that every contour is closed.
function densityOf({ modes, box }, cells) {
  const [dx, dy] = [(box[2] - box[0]) / (cells - 3), (box[3] - box[1]) / (cells - 3)];
  const [x0, y0] = [box[0] - dx, box[1] - dy];
  const values = new Float32Array(cells * cells);
  const range = (middle, reach, begin, step) =>
    [Math.max(Math.ceil((middle - reach - begin) / step), 1), Math.min(Math.floor((middle + reach - begin) / step), cells - 2)];
  for (const [weight, x, y, a, b, c, sx, sy] of modes) {
    const [col0, col1] = range(x, sx, x0, dx);
    const [row0, row1] = range(y, sy, y0, dy);
    const least = weight * 1e-5;
    const bend = Math.exp(-2 * a * dx * dx);
    for (let row = row0; row <= row1; row++) {
      const v = y0 + row * dy - y;
      // From the cell with the most, to both sides. The ratio of neighbours changes by a constant factor.
      const peak = Math.min(Math.max(Math.round((x - b * v / (2 * a) - x0) / dx), col0), col1);
      const u = x0 + peak * dx - x;
      const most = weight * Math.exp(-(a * u * u + b * u * v + c * v * v));
      values[row * cells + peak] += most;
      for (const step of [1, -1]) {
        let [value, ratio] = [most, Math.exp(-(a * dx * dx + step * dx * (2 * a * u + b * v)))];
        for (let col = peak + step; col >= col0 && col <= col1 && value > least; col += step) {
          value *= ratio;
          ratio *= bend;
          values[row * cells + col] += value;
        }
      }
    }
  }
  // Sums by value, in steps that are finer for small values.
  let [most, total] = [0, 0];
  for (const value of values) {
    total += value;
    if (value > most) most = value;
  }
  const sums = new Float64Array(BINS + 1);
  for (const value of values) sums[Math.floor(Math.sqrt(value / most) * BINS)] += value;
  const levels = [];
  let above = 0;
  for (let bin = BINS; bin >= 0 && levels.length < 2; bin--) {
    let wanted;
    while (levels.length < 2 && above + sums[bin] >= (wanted = [0.5, 0.9][levels.length] * total)) {
      const level = ((bin + 1 - (wanted - above) / sums[bin]) / BINS) ** 2 * most;
      levels.push(Math.min(level, 0.99 * most));
    }
    above += sums[bin];
  }
  return { values, cells, x0, y0, dx, dy, levels };
}

// The most cells along a side of a density.
const CELLS_MAX = 26;
// For each edge of a grid the edge at which a border enters next; 0 if no border leaves there.
const nextEdge = new Int32Array(2 * CELLS_MAX * CELLS_MAX);

// Traces the borders of the area above a level: marching squares, linked to closed lines. The density is relative to
// `origin`.
function traceRegion(path, { values, cells, x0, y0, dx, dy }, level, origin) {
  // An edge of the grid is named by twice its first corner, plus 1 if it goes along a column. The border of the grid
  // is outside, so no border of the area crosses edge 0.
  const leaves = [];
  for (let row = 0; row + 1 < cells; row++) {
    for (let col = 0; col + 1 < cells; col++) {
      const at = row * cells + col;
      const corners = (values[at] >= level) | (values[at + 1] >= level) << 1 |
        (values[at + cells + 1] >= level) << 2 | (values[at + cells] >= level) << 3;
      if (corners === 0 || corners === 15) continue;
      const inside = (side) => corners >> (side & 3) & 1;
      const edges = [2 * at, 2 * (at + 1) + 1, 2 * (at + cells), 2 * at + 1];
      for (let side = 0; side < 4; side++) {
        if (!inside(side) || inside(side + 1)) continue;
        // The border leaves through this side, and enters through the next side that it crosses.
        let other = side + 1;
        while (inside(other) || !inside(other + 1)) other++;
        nextEdge[edges[side]] = edges[other & 3];
        leaves.push(edges[side]);
      }
    }
  }
  const point = (edge, isFirst) => {
    const [at, isColumn] = [edge >> 1, edge & 1];
    const [value, after] = [values[at], values[at + (isColumn ? cells : 1)]];
    const share = (level - value) / (after - value);
    const [row, col] = [Math.floor(at / cells), at % cells];
    const x = origin[0] + x0 + (col + (isColumn ? 0 : share)) * dx;
    const y = origin[1] + y0 + (row + (isColumn ? share : 0)) * dy;
    if (isFirst) path.moveTo(x, y); else path.lineTo(x, y);
  };
  for (const first of leaves) {
    if (!nextEdge[first]) continue;
    point(first, true);
    for (let edge = first; ;) {
      const after = nextEdge[edge];
      nextEdge[edge] = 0;
      if (!after || after === first) break;
      point(after, false);
      edge = after;
    }
    path.closePath();
  }
}

// The places where agents have been: a picture with a pixel for each square metre.
class Places {
  constructor() {
    this.canvas = document.createElement("canvas");
    this.canvas.width = this.canvas.height = 1024;
    this.context = this.canvas.getContext("2d");
    this.context.fillStyle = "rgba(138, 151, 165, 0.22)";
    this.last = new Map();
  }

  // Places farther than half a kilometre from the first one are left out.
  add(agent) {
    const place = agent.p.map((value) => Math.round(value / 100));
    this.origin ??= place.map((value) => value - 512);
    const [x, y] = [place[0] - this.origin[0], place[1] - this.origin[1]];
    const key = x * 4096 + y;
    if (this.last.get(agent.i) === key) return;
    if (this.last.size > 4000) this.last.clear();
    this.last.set(agent.i, key);
    this.context.fillRect(x, y, 1, 1);
  }

  draw(context) {
    if (!this.origin) return;
    context.imageSmoothingEnabled = false;
    const [x, y] = this.origin;
    context.drawImage(this.canvas, (x - 0.5) * 100, (y - 0.5) * 100, 102400, 102400);
  }
}

// The shapes of the vocabulary, about 8 pixels wide.
const SHAPES = {
  disc: "M-3 0A3 3 0 1 0 3 0A3 3 0 1 0-3 0Z", square: "M-3-3H3V3H-3Z", ring: "M-3.2 0A3.2 3.2 0 1 0 3.2 0A3.2 3.2 0 1 0-3.2 0Z",
  triangle: "M0-4L4 3H-4Z", cross: "M-3.4-3.4L3.4 3.4M3.4-3.4L-3.4 3.4", diamond: "M0-4.4L4.4 0L0 4.4L-4.4 0Z",
  plus: "M-4 0H4M0-4V4",
};
const OPEN_SHAPES = ["ring", "cross", "plus"];

class SceneCanvas {
  constructor(canvas, options = {}) {
    this.canvas = canvas;
    this.options = Object.assign({ interactive: true, regions: true, onPick: null }, options);
    this.context = canvas.getContext("2d");
    this.scene = null;
    this.lanes = [];
    this.follow = null;
    this.selected = null;
    this.layers = Object.fromEntries(LAYERS.map(([name, , isShown]) => [name, isShown]));
    this.later = null; // by track: where it was tracked later
    this.past = []; // earlier forecasts of the selected agent
    this.ruler = null; // while it is on: its two ends in cm
    this.center = null;
    this.scale = 6; // pixels per metre
    this.fitted = false;
    this.places = new Places();
    this.regions = new WeakMap();
    this.draws = 0;
    this.pointers = new Map();
    this.colors = palette();
    if (this.options.interactive) this.listen();
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.resize();
  }

  resize() {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    [this.width, this.height, this.ratio] = [width, height, ratio];
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    if (!this.moved) this.fitted = false;
    this.draw();
  }

  theme() {
    this.colors = palette();
    this.draw();
  }

  show(scene) {
    this.scene = scene;
    scene.agents.forEach((agent) => this.places.add(agent));
    this.request();
  }

  request() {
    if (this.requested) return;
    this.requested = true;
    requestAnimationFrame(() => {
      this.requested = false;
      this.draw();
    });
  }

  // Fits all agents and the ends of their forecasts.
  fit() {
    const points = [];
    for (const { p, f } of this.scene ? this.scene.agents : []) {
      points.push(p);
      if (f && f.b.length) points.push([p[0] + f.b[f.b.length - 2], p[1] + f.b[f.b.length - 1]]);
    }
    if (this.scene && this.scene.ego) points.push(this.scene.ego.map((value) => value * 100));
    if (!points.length) return;
    const range = (axis) => {
      const sorted = points.map((point) => point[axis] / 100).sort((a, b) => a - b);
      const cut = Math.floor(sorted.length * 0.02);
      return [sorted[cut], sorted[sorted.length - 1 - cut]];
    };
    const [[x0, x1], [y0, y1]] = [range(0), range(1)];
    this.center = [(x0 + x1) / 2, (y0 + y1) / 2];
    const margin = 12;
    this.scale = Math.min(this.width / (x1 - x0 + margin), this.height / (y1 - y0 + margin), 40);
    this.fitted = true;
    this.moved = false;
  }

  // Fits again if most agents have left the view and nobody has moved it.
  keepInView() {
    if (!this.scene || !this.center || !this.width || this.moved || this.follow) return;
    const seen = this.scene.agents.filter(({ p }) => this.isOnScreen(p, 0)).length;
    if (seen < this.scene.agents.length / 2) this.fit();
  }

  isOnScreen([x, y], margin) {
    const [sx, sy] = this.toScreen(x, y);
    return sx > -margin && sy > -margin && sx < this.width + margin && sy < this.height + margin;
  }

  toWorld(x, y) {
    return [(this.center[0] + (x - this.width / 2) / this.scale) * 100, (this.center[1] + (this.height / 2 - y) / this.scale) * 100];
  }

  // Puts a place in cm into the middle, near enough to see it.
  lookAt([x, y]) {
    this.setFollow(null);
    this.center = [x / 100, y / 100];
    this.scale = Math.max(this.scale, 10);
    this.moved = this.fitted = true;
    this.request();
  }

  toScreen(x, y) {
    return [this.width / 2 + (x / 100 - this.center[0]) * this.scale,
            this.height / 2 - (y / 100 - this.center[1]) * this.scale];
  }

  zoom(factor, x, y) {
    const scale = Math.min(Math.max(this.scale * factor, 0.3), 120);
    const [dx, dy] = [x - this.width / 2, this.height / 2 - y];
    if (!this.follow && this.center) {
      this.center[0] += dx / this.scale - dx / scale;
      this.center[1] += dy / this.scale - dy / scale;
    }
    this.scale = scale;
    this.moved = true;
    this.request();
  }

  listen() {
    const canvas = this.canvas;
    canvas.style.touchAction = "none";
    const place = (event) => {
      const box = canvas.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * 0.0015), ...place(event));
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, place(event));
      if (this.pointers.size === 1) this.pressed = place(event);
      if (this.ruler && this.center) this.ruler = [this.toWorld(...place(event)), this.toWorld(...place(event))];
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = this.pointers.get(event.pointerId);
      if (!before || !this.center) return;
      const now = place(event);
      if (this.ruler && this.pointers.size === 1) {
        this.ruler[1] = this.toWorld(...now);
        this.request();
        return;
      }
      if (this.pointers.size === 2) {
        const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
        const apart = (point) => Math.hypot(point[0] - other[0], point[1] - other[1]);
        this.zoom(apart(now) / Math.max(apart(before), 1), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
        this.pressed = null;
      } else if (!this.pressed || Math.hypot(now[0] - this.pressed[0], now[1] - this.pressed[1]) > 5) {
        this.pressed = null;
        this.moved = true;
        this.setFollow(null);
        this.center[0] -= (now[0] - before[0]) / this.scale;
        this.center[1] += (now[1] - before[1]) / this.scale;
        this.request();
      }
      if (this.pointers.size === 2 || !this.pressed) this.pointers.set(event.pointerId, now);
    });
    const release = (event) => {
      this.pointers.delete(event.pointerId);
      if (event.type === "pointerup" && this.pressed && !this.ruler) {
        // A finger is wider than a pointer.
        this.pick(...this.pressed, event.pointerType === "touch" ? 40 : 24);
      }
      this.pressed = null;
    };
    canvas.addEventListener("pointerup", release);
    canvas.addEventListener("pointercancel", release);
    canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      // Without Shift, the arrow keys belong to the time line.
      if (step && this.center && event.shiftKey) {
        this.setFollow(null);
        this.moved = true;
        this.center = this.center.map((value, axis) => value + step[axis] * 60 / this.scale);
        event.preventDefault();
        event.stopPropagation();
      } else if (event.key === "+") this.zoom(1.25, this.width / 2, this.height / 2);
      else if (event.key === "-") this.zoom(0.8, this.width / 2, this.height / 2);
      else if (event.key === "0") { this.setFollow(null); this.fit(); }
      else return;
      this.request();
    });
  }

  // Follows the ego vehicle ("ego"), an agent by its number, or nothing (null).
  setFollow(what) {
    if (this.follow === what) return;
    this.follow = what;
    if (this.options.onFollow) this.options.onFollow(what);
  }

  pick(x, y, reach = 24) {
    if (!this.scene || !this.center) return;
    let [best, least] = [null, reach];
    for (const agent of this.scene.agents) {
      const [ax, ay] = this.toScreen(agent.p[0], agent.p[1]);
      const apart = Math.hypot(ax - x, ay - y);
      if (apart < least) [best, least] = [agent, apart];
    }
    this.selected = best ? best.i : null;
    if (this.options.onPick) this.options.onPick(best);
    this.request();
  }

  draw() {
    const { context, scene, colors } = this;
    if (!this.width) return;
    if (scene && !this.fitted) this.fit();
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    context.fillStyle = colors.ground;
    context.fillRect(0, 0, this.width, this.height);
    if (!scene || !this.center) return;
    if (this.follow === "ego" && scene.ego) this.center = [scene.ego[0], scene.ego[1]];
    const followed = this.follow && scene.agents.find((agent) => agent.i === this.follow);
    if (followed) this.center = followed.p.map((value) => value / 100);
    const k = this.scale / 100 * this.ratio;
    // From here on, one unit is one centimetre of the world.
    this.world = [k, 0, 0, -k, this.ratio * this.width / 2 - this.center[0] * 100 * k,
                  this.ratio * this.height / 2 + this.center[1] * 100 * k];
    this.thin = 100 / this.scale;
    context.setTransform(...this.world);
    const { layers } = this;
    if (layers.places) this.places.draw(context);
    this.drawGrid();
    if (layers.lanes) this.drawLanes();
    const margin = Math.min(60 * this.scale, 600);
    const seen = scene.agents.filter(({ p }) => this.isOnScreen(p, margin));
    if (this.options.regions && layers.regions) this.drawRegions();
    if (this.later) seen.forEach((agent) => this.drawLater(agent));
    seen.forEach((agent) => this.drawPaths(agent));
    this.drawPast();
    if (scene.ego) this.drawEgo(scene.ego);
    seen.forEach((agent) => this.drawBody(agent));
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    if (layers.conflicts) this.drawConflicts();
    this.drawLabels(seen);
    this.drawRuler();
    this.drawScale();
    this.draws++;
  }

  // The length between grid lines, m: 1, 2 or 5 times a power of ten.
  gridStep() {
    const least = 70 / this.scale;
    const power = 10 ** Math.floor(Math.log10(least));
    return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= least);
  }

  drawGrid() {
    const { context, center, width, height, scale } = this;
    const step = this.gridStep();
    context.strokeStyle = this.colors.grid;
    context.lineWidth = this.thin;
    context.beginPath();
    const [x0, x1] = [center[0] - width / 2 / scale, center[0] + width / 2 / scale];
    const [y0, y1] = [center[1] - height / 2 / scale, center[1] + height / 2 / scale];
    for (let x = Math.ceil(x0 / step) * step; x < x1; x += step) {
      context.moveTo(x * 100, y0 * 100);
      context.lineTo(x * 100, y1 * 100);
    }
    for (let y = Math.ceil(y0 / step) * step; y < y1; y += step) {
      context.moveTo(x0 * 100, y * 100);
      context.lineTo(x1 * 100, y * 100);
    }
    context.stroke();
  }

  drawLanes() {
    const { context } = this;
    context.strokeStyle = this.colors.lane;
    context.lineWidth = 1.2 * this.thin;
    if (this.drawnLanes !== this.lanes) {
      this.drawnLanes = this.lanes;
      this.lanePath = new Path2D();
      for (const bound of this.lanes) {
        for (let at = 0; at < bound.length; at += 2) {
          if (at) this.lanePath.lineTo(bound[at], bound[at + 1]); else this.lanePath.moveTo(bound[at], bound[at + 1]);
        }
      }
    }
    context.stroke(this.lanePath);
  }

  // The regions of all agents, with one path for each colour and level: few large paths are drawn faster than many.
  drawRegions() {
    const { context, scene } = this;
    let drawn = this.regions.get(scene);
    // A closer view needs finer regions.
    if (!drawn || this.scale > 1.5 * drawn.scale) {
      drawn = { scale: this.scale, paths: new Map() };
      scene.agents.forEach((agent) => agent.f && agent.f.e && this.addRegions(drawn.paths, agent));
      this.regions.set(scene, drawn);
    }
    for (const [cause, levels] of drawn.paths) {
      context.fillStyle = colorOf(this.colors, { c: cause });
      [0.17, 0.1].forEach((alpha, place) => {
        context.globalAlpha = alpha;
        context.fill(levels[place]);
      });
    }
    context.globalAlpha = 1;
  }

  addRegions(paths, { p, f }) {
    const shape = shapeOf(f.e);
    if (!shape.modes.length) return;
    // Small regions need few cells: one for each five pixels.
    const side = Math.max(shape.box[2] - shape.box[0], shape.box[3] - shape.box[1]) / this.thin;
    const density = densityOf(shape, Math.min(Math.max(Math.ceil(side / 5) + 3, 12), CELLS_MAX));
    if (!paths.has(f.c)) paths.set(f.c, [new Path2D(), new Path2D()]);
    density.levels.forEach((level, place) => traceRegion(paths.get(f.c)[place], density, level, p));
  }

  trace(origin, flat, fromOrigin) {
    const { context } = this;
    context.beginPath();
    let draws = fromOrigin;
    if (fromOrigin) context.moveTo(origin[0], origin[1]);
    for (let at = 0; at < flat.length; at += 2) {
      if (flat[at] === null) { draws = false; continue; }
      const [x, y] = [origin[0] + flat[at], origin[1] + flat[at + 1]];
      if (draws) context.lineTo(x, y); else context.moveTo(x, y);
      draws = true;
    }
  }

  drawPaths(agent) {
    const { context, colors, thin } = this;
    const { p, f, y } = agent;
    const { layers } = this;
    context.lineJoin = context.lineCap = "round";
    context.strokeStyle = colors.soft;
    context.lineWidth = 1.4 * thin;
    if (layers.histories && y && y.length) {
      this.trace(p, y, false);
      context.lineTo(p[0], p[1]);
      context.stroke();
    }
    if (!f) return;
    const look = LOOKS[f.c];
    context.strokeStyle = colorOf(colors, f);
    context.setLineDash(look ? look.dash.map((length) => length * thin) : []);
    if (look && look.dash.length) context.lineCap = "butt";
    for (const [probability, points] of layers.modes ? f.m || [] : []) {
      if (probability < IMPROBABLE && !layers.improbable) continue;
      context.globalAlpha = 0.2 + 0.6 * Math.min(probability / 400, 1);
      context.lineWidth = (0.8 + 1.6 * Math.min(probability / 500, 1)) * thin;
      this.trace(p, points, true);
      context.stroke();
    }
    context.globalAlpha = 1;
    if (layers.forecasts) {
      context.lineWidth = 2.2 * thin;
      this.trace(p, f.b, true);
      context.stroke();
    }
    context.setLineDash([]);
    if (!layers.forecasts) return;
    const end = f.b.length - 2;
    if (end >= 0) this.drawEnd(look, p[0] + f.b[end], p[1] + f.b[end + 1], colorOf(colors, f));
  }

  // The shape of a cause at the end of a forecast.
  drawEnd(look, x, y, color) {
    const { context, thin } = this;
    context.save();
    context.translate(x, y);
    context.scale(thin, -thin);
    const path = new Path2D(SHAPES[look ? look.shape : "disc"]);
    context.fillStyle = context.strokeStyle = color;
    context.lineWidth = 1.8;
    if (!OPEN_SHAPES.includes(look && look.shape)) context.fill(path);
    context.stroke(path);
    context.restore();
  }

  // Where an agent was tracked later.
  drawLater({ i, p }) {
    const path = this.later.get(i);
    if (!path || path.length < 4) return;
    const { context, colors, thin } = this;
    context.strokeStyle = colors.ink;
    context.lineWidth = 1.6 * thin;
    context.globalAlpha = 0.75;
    context.beginPath();
    for (let at = 0; at < path.length; at += 2) {
      if (at) context.lineTo(path[at], path[at + 1]); else context.moveTo(path[at], path[at + 1]);
    }
    context.stroke();
    context.globalAlpha = 1;
  }

  // The selected agent's forecasts of some seconds ago, each from where it was made.
  drawPast() {
    const { context, colors, thin } = this;
    for (const { age, p, f } of this.past) {
      context.strokeStyle = colors.select;
      context.lineWidth = 1.8 * thin;
      context.globalAlpha = 1 - age / 8;
      context.setLineDash([2 * age * thin, 2.5 * thin]);
      this.trace(p, f.b, true);
      context.stroke();
      context.setLineDash([]);
      context.globalAlpha = 1;
      const end = f.b.length - 2;
      this.drawEnd(LOOKS[f.c], p[0] + f.b[end], p[1] + f.b[end + 1], colors.select);
    }
  }

  drawConflicts() {
    const { context, colors } = this;
    for (const [, , p, , , x, y] of this.scene.k || []) {
      const [sx, sy] = this.toScreen(x, y);
      context.strokeStyle = colors.bad;
      context.lineWidth = 1 + p / 500;
      context.beginPath();
      context.arc(sx, sy, 9, 0, 7);
      context.moveTo(sx - 5, sy - 5);
      context.lineTo(sx + 5, sy + 5);
      context.moveTo(sx + 5, sy - 5);
      context.lineTo(sx - 5, sy + 5);
      context.stroke();
    }
  }

  drawRuler() {
    const { context, colors, ruler } = this;
    if (!ruler || ruler.length < 2) return;
    const [[ax, ay], [bx, by]] = ruler.map((point) => this.toScreen(...point));
    context.strokeStyle = colors.select;
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(ax, ay);
    context.lineTo(bx, by);
    context.stroke();
    this.measured = Math.hypot(ruler[1][0] - ruler[0][0], ruler[1][1] - ruler[0][1]) / 100;
    context.font = "600 13px system-ui, sans-serif";
    context.lineWidth = 4;
    context.strokeStyle = colors.ground;
    context.strokeText(`${this.measured.toFixed(2)} m`, bx + 8, by - 8);
    context.fillStyle = colors.select;
    context.fillText(`${this.measured.toFixed(2)} m`, bx + 8, by - 8);
  }

  drawBody(agent) {
    const { context, colors, thin } = this;
    const { p, f, t, h, s } = agent;
    const sizes = [[450, 190], [180, 60], [60, 60]][t] || [60, 60];
    const least = 7 * thin;
    const length = Math.max(s[0] || sizes[0], least);
    const width = Math.max(s[1] || sizes[1], t === 0 ? least / 2 : least * 0.6);
    context.save();
    context.translate(p[0], p[1]);
    context.rotate(h / 1000);
    const color = colorOf(colors, f);
    context.beginPath();
    if (t === 2) context.arc(0, 0, Math.max(length, width) / 2, 0, 7);
    else if (context.roundRect) context.roundRect(-length / 2, -width / 2, length, width, width / 4);
    else context.rect(-length / 2, -width / 2, length, width);
    context.fillStyle = color;
    context.globalAlpha = agent.u > 200 ? 0.35 : 0.9;
    context.fill();
    context.globalAlpha = 1;
    context.strokeStyle = this.selected === agent.i ? colors.select : colors.ground;
    context.lineWidth = (this.selected === agent.i ? 2.5 : 1) * thin;
    if (f && f.q > 0 && this.selected !== agent.i) {
      context.strokeStyle = colors.ink;
      context.setLineDash(f.q === 1 ? [4 * thin, 3 * thin] : [1.5 * thin, 2.5 * thin]);
    }
    context.stroke();
    context.setLineDash([]);
    if (t !== 2) {
      // The front.
      context.beginPath();
      context.moveTo(length / 2 - length * 0.12, 0);
      context.lineTo(length * 0.12, width * 0.3);
      context.lineTo(length * 0.12, -width * 0.3);
      context.closePath();
      context.fillStyle = colors.ground;
      context.globalAlpha = 0.85;
      context.fill();
    }
    context.restore();
    if (this.selected === agent.i) {
      context.beginPath();
      context.arc(p[0], p[1], Math.max(length, width) / 2 + 7 * thin, 0, 7);
      context.strokeStyle = colors.select;
      context.lineWidth = 1.5 * thin;
      context.stroke();
    }
  }

  drawEgo([x, y, heading]) {
    const { context, colors, thin } = this;
    context.save();
    context.translate(x * 100, y * 100);
    context.rotate(heading);
    // The footprint of a typical car, true to scale, and an arrow that stays visible from afar.
    const [length, width] = EGO_CM;
    context.beginPath();
    context.rect(-length / 2, -width / 2, length, width);
    context.strokeStyle = context.fillStyle = colors.ego;
    context.lineWidth = 1.6 * thin;
    context.globalAlpha = 0.25;
    context.fill();
    context.globalAlpha = 1;
    context.stroke();
    const [reach, half] = [Math.max(length / 2, 7 * thin), Math.max(width / 2.6, 4 * thin)];
    context.beginPath();
    context.moveTo(reach, 0);
    context.lineTo(-reach * 0.7, half);
    context.lineTo(-reach * 0.4, 0);
    context.lineTo(-reach * 0.7, -half);
    context.closePath();
    context.fill();
    context.restore();
  }

  // Labels of agents and of the most probable modes; a label that would cover another is left out.
  drawLabels(seen) {
    const { context, colors } = this;
    const taken = [];
    const put = (text, x, y, color, size) => {
      context.font = `${size}px system-ui, sans-serif`;
      const width = context.measureText(text).width;
      const box = [x - 2, y - size, x + width + 2, y + 3];
      if (taken.some((other) => box[0] < other[2] && box[2] > other[0] && box[1] < other[3] && box[3] > other[1])) {
        return;
      }
      taken.push(box);
      context.lineWidth = 3;
      context.strokeStyle = colors.ground;
      context.strokeText(text, x, y);
      context.fillStyle = color;
      context.fillText(text, x, y);
    };
    const chosen = (agent) => (agent.i === this.selected ? 0 : 1);
    const detailed = this.scale > 9;
    for (const agent of seen.slice().sort((a, b) => chosen(a) - chosen(b))) {
      const isChosen = agent.i === this.selected;
      if (!detailed && !isChosen) continue;
      const [x, y] = this.toScreen(agent.p[0], agent.p[1]);
      put(agent.n, x + 8, y - 8, isChosen ? colors.select : colors.ink, isChosen ? 13 : 11);
      const modes = this.layers.modes && agent.f && agent.f.m && (isChosen || this.scale > 14) ? agent.f.m : [];
      for (const [probability, points] of modes) {
        if (probability < IMPROBABLE && !this.layers.improbable) continue;
        const end = points.length - 2;
        if (end < 0) continue;
        const [ex, ey] = this.toScreen(agent.p[0] + points[end], agent.p[1] + points[end + 1]);
        put(Math.round(probability / 10) + " %", ex + 5, ey + 4, colorOf(colors, agent.f), 10.5);
      }
    }
  }

  drawScale() {
    const { context, colors, height } = this;
    const step = this.gridStep();
    const [x, y, length] = [16, height - 18, step * this.scale];
    context.globalAlpha = 0.8;
    context.fillStyle = colors.ground;
    context.fillRect(x - 6, y - 11, length + 52, 20);
    context.globalAlpha = 1;
    context.strokeStyle = colors.ink;
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(x, y - 4);
    context.lineTo(x, y);
    context.lineTo(x + length, y);
    context.lineTo(x + length, y - 4);
    context.stroke();
    context.font = "11px system-ui, sans-serif";
    context.fillStyle = colors.ink;
    context.fillText(`${step} m`, x + length + 6, y + 3);
  }
}

// A cause in words. A newer version's cause is a number.
function causeWords(cause) {
  return LOOKS[cause] ? LOOKS[cause].words : `cause ${cause}`;
}

// A cause as a line with its dash and shape, or its shape alone.
function glyphOf(cause, isShort = false) {
  const look = LOOKS[cause] || { cause: "unknown", dash: [], shape: "disc" };
  const color = LOOKS[cause] ? `var(--cause-${look.cause})` : "var(--unknown)";
  const fill = OPEN_SHAPES.includes(look.shape) ? "none" : color;
  return `<svg width="${isShort ? 12 : 34}" height="12" viewBox="${isShort ? "22 0 12 12" : "0 0 34 12"}" aria-hidden="true"><g stroke="${color}" stroke-width="2"><path d="${isShort ? "" : "M0 6H26"}" ` +
    `stroke-dasharray="${look.dash.join(" ")}" fill="none"/><path d="${SHAPES[look.shape]}" transform="translate(28 6)" fill="${fill}"/></g></svg>`;
}

// The legend: what colours, dashes and shapes mean, for the causes that occur.
function legendOf(causes, extra = "") {
  const items = causes.map((cause) => `<span class="key" title="${LOOKS[cause] ? explanationOf(cause, 0) : ""}">${glyphOf(cause)}` +
    `${causeWords(cause)}</span>`);
  return items.join("") + extra;
}

// Why a forecast is as it is, for agents of a type.
function explanationOf(cause, type) {
  return LOOKS[cause] ? LOOKS[cause].explanation.replace("{agents}", PLURALS[type] || "agents") : `Cause ${cause} of a newer version`;
}
