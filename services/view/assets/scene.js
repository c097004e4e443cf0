"use strict";
// Draws the scene of a tick on a canvas, with pan, zoom, pinch and picking. The live page and the report use it.
// A scene is what scene.rs writes: lengths in cm, positions of an agent relative to its own.

const TYPES = ["vehicle", "cyclist", "pedestrian"];
const QUALITIES = ["learned", "held", "kinematic"];
const CAUSES = ["none", "late", "rejected", "missing", "young", "outdone", "shed"];
const CAUSE_WORDS = {
  none: "learned", late: "late", rejected: "rejected", missing: "missing", young: "too young",
  outdone: "constant velocity better", shed: "shed to save time",
};
const EXPERTS = ["network", "base", "constant velocity", "decaying turn", "process model",
                 "decaying acceleration", "following", "lane"];

const root = document.documentElement;
const systemDark = matchMedia("(prefers-color-scheme: dark)");
root.dataset.theme = systemDark.matches ? "dark" : "light";

// The value of a style variable, so that canvases follow the theme.
function themed(name) {
  return getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
}

function palette() {
  const colors = {};
  for (const name of ["ground", "grid", "ink", "soft", "faint", "lane", "ego", "select", "unknown"]) {
    colors[name] = themed(name);
  }
  colors.cause = CAUSES.map((cause) => themed("cause-" + cause));
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

class SceneCanvas {
  constructor(canvas, options = {}) {
    this.canvas = canvas;
    this.options = Object.assign({ interactive: true, regions: true, onPick: null }, options);
    this.context = canvas.getContext("2d");
    this.scene = null;
    this.lanes = [];
    this.follow = null;
    this.selected = null;
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
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = this.pointers.get(event.pointerId);
      if (!before || !this.center) return;
      const now = place(event);
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
      if (event.type === "pointerup" && this.pressed) this.pick(...this.pressed);
      this.pressed = null;
    };
    canvas.addEventListener("pointerup", release);
    canvas.addEventListener("pointercancel", release);
    canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      if (step && this.center) {
        this.setFollow(null);
        this.moved = true;
        this.center = this.center.map((value, axis) => value + step[axis] * 60 / this.scale);
        event.preventDefault();
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

  pick(x, y) {
    if (!this.scene || !this.center) return;
    let [best, least] = [null, 24];
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
    this.places.draw(context);
    this.drawGrid();
    this.drawLanes();
    const reach = 6000;
    const seen = scene.agents.filter(({ p }) => {
      const [x, y] = this.toScreen(p[0], p[1]);
      const margin = Math.min(reach * this.scale / 100, 600);
      return x > -margin && y > -margin && x < this.width + margin && y < this.height + margin;
    });
    if (this.options.regions) this.drawRegions();
    seen.forEach((agent) => this.drawPaths(agent));
    if (scene.ego) this.drawEgo(scene.ego);
    seen.forEach((agent) => this.drawBody(agent));
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    this.drawLabels(seen);
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
    context.lineJoin = context.lineCap = "round";
    context.strokeStyle = colors.soft;
    context.lineWidth = 1.4 * thin;
    if (y && y.length) {
      this.trace(p, y, false);
      context.lineTo(p[0], p[1]);
      context.stroke();
    }
    if (!f) return;
    context.strokeStyle = colorOf(colors, f);
    for (const [probability, points] of f.m || []) {
      context.globalAlpha = 0.25 + 0.55 * Math.min(probability / 400, 1);
      context.lineWidth = (0.8 + 1.6 * Math.min(probability / 500, 1)) * thin;
      this.trace(p, points, true);
      context.stroke();
    }
    context.globalAlpha = 1;
    context.lineWidth = 2.2 * thin;
    this.trace(p, f.b, true);
    context.stroke();
    const end = f.b.length - 2;
    if (end >= 0) {
      context.fillStyle = colorOf(colors, f);
      context.beginPath();
      context.arc(p[0] + f.b[end], p[1] + f.b[end + 1], 2.6 * thin, 0, 7);
      context.fill();
    }
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
    context.beginPath();
    const [length, width] = [Math.max(460, 12 * thin), Math.max(190, 6 * thin)];
    context.moveTo(length / 2, 0);
    context.lineTo(-length / 2, width / 2);
    context.lineTo(-length / 3, 0);
    context.lineTo(-length / 2, -width / 2);
    context.closePath();
    context.fillStyle = colors.ego;
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
      const modes = agent.f && agent.f.m && (isChosen || this.scale > 14) ? agent.f.m : [];
      for (const [probability, points] of modes) {
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
  return CAUSE_WORDS[CAUSES[cause]] || `cause ${cause}`;
}

// The legend: what colours and outlines mean, for the causes that occur.
function legendOf(causes, extra = "") {
  const color = (cause) => CAUSES[cause] ? "cause-" + CAUSES[cause] : "unknown";
  const items = causes.map((cause) => `<span class="key"><i style="background:var(--${color(cause)})"></i>` +
    `${causeWords(cause)}</span>`);
  return items.join("") + extra;
}
