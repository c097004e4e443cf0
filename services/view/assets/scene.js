"use strict";
// Draws the scene of a tick on a canvas. The live page and the report use it.
// A scene is what scene.rs writes: lengths in cm, positions of an agent relative to its own.

// The layers of a scene that can be switched: name, words, and whether they are shown at first.
const LAYERS = [
  ["forecasts", "forecasts", true], ["modes", "modes", true], ["improbable", "modes below 2 %", false],
  ["regions", "regions", true], ["histories", "histories", true], ["lanes", "lanes", true],
  ["places", "places seen", true], ["truth", "where they went", false], ["conflicts", "conflicts", true],
];
// Modes with a smaller probability, in thousandths, belong to the layer "improbable".
const IMPROBABLE = 20;

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

class SceneCanvas extends View {
  lanes = [];
  layers = Object.fromEntries(LAYERS.map(([name, , isShown]) => [name, isShown]));
  later = null; // by track: where it was tracked later
  past = []; // earlier forecasts of the selected agent
  places = new Places();
  regions = new WeakMap(); // by scene: its paths
  draws = 0;

  show(scene) {
    this.scene = scene;
    scene.agents.forEach((agent) => this.places.add(agent));
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
    // Marks of far agents are smaller, so that they do not cover each other.
    this.mark = Math.min(Math.max(this.scale / 5, 0.55), 1) * this.thin;
    context.setTransform(...this.world);
    const { layers } = this;
    if (layers.places) this.places.draw(context);
    this.drawGrid();
    if (layers.lanes) this.drawLanes();
    const margin = Math.min(60 * this.scale, 600);
    const seen = scene.agents.filter(({ p }) => this.isOnScreen(p, margin));
    if (this.options.regions && layers.regions) this.drawRegions(seen);
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
    const least = Math.min(70, this.width / 5) / this.scale;
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

  // The regions of the agents in view, with one path for each colour and level: few large paths are drawn faster than
  // many. They are kept, because a scene is drawn many times while the view moves.
  drawRegions(seen) {
    const { context, scene } = this;
    let drawn = this.regions.get(scene);
    // A closer view needs finer regions.
    if (!drawn || this.scale > 1.5 * drawn.scale) {
      drawn = { scale: this.scale, paths: new Map(), agents: new Set() };
      this.regions.set(scene, drawn);
    }
    for (const agent of seen) {
      if (!agent.f || !agent.f.e || drawn.agents.has(agent)) continue;
      drawn.agents.add(agent);
      if (!drawn.paths.has(agent.f.c)) drawn.paths.set(agent.f.c, [new Path2D(), new Path2D()]);
      addRegions(drawn.paths.get(agent.f.c), agent.f.e, agent.p, this.thin);
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
    const { context, mark } = this;
    context.save();
    context.translate(x, y);
    context.scale(mark, -mark);
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

  // Other forecasts, dashed: the selected agent's of some seconds ago, each from where it was made, or those of another
  // run.
  drawPast() {
    const { context, colors, thin, mark } = this;
    context.strokeStyle = colors.select;
    for (const { age, p, f } of this.past) {
      const end = f.b.length - 2;
      // It would only cover its agent.
      if (Math.hypot(f.b[end], f.b[end + 1]) < 8 * thin) continue;
      context.lineWidth = 1.8 * thin;
      context.globalAlpha = 1 - age / 8;
      context.setLineDash([2 * age * thin, 2.5 * thin]);
      this.trace(p, f.b, true);
      context.stroke();
      context.setLineDash([]);
      context.beginPath();
      context.arc(p[0] + f.b[end], p[1] + f.b[end + 1], 3.4 * mark, 0, 7);
      context.stroke();
    }
    context.globalAlpha = 1;
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

  // Length and width with which an agent is drawn.
  sizeOf({ s, t }) {
    const sizes = [[450, 190], [180, 60], [60, 60]][t] || [60, 60];
    const least = 7 * this.mark;
    return [Math.max(s[0] || sizes[0], least), Math.max(s[1] || sizes[1], t === 0 ? least / 2 : least * 0.6)];
  }

  drawBody(agent) {
    const { context, colors, thin } = this;
    const { p, f, t, h } = agent;
    const [length, width] = this.sizeOf(agent);
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
    if (f && f.q > 0 && this.selected !== agent.i && length > 12 * thin) {
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
      // Outside of the ring of the selection.
      const away = isChosen ? 8 + 0.71 * Math.max(...this.sizeOf(agent)) / 2 / this.thin : 8;
      put(agent.n, x + away, y - away, isChosen ? colors.select : colors.ink, isChosen ? 13 : 11);
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
    context.font = "11px system-ui, sans-serif";
    context.fillStyle = colors.ink;
    // A halo keeps it legible on agents.
    for (const [color, line] of [[colors.ground, 4], [colors.ink, 1.5]]) {
      context.strokeStyle = color;
      context.lineWidth = line;
      context.beginPath();
      context.moveTo(x, y - 4);
      context.lineTo(x, y);
      context.lineTo(x + length, y);
      context.lineTo(x + length, y - 4);
      context.stroke();
      if (color === colors.ground) context.strokeText(`${step} m`, x + length + 6, y + 3);
    }
    context.fillText(`${step} m`, x + length + 6, y + 3);
  }
}
