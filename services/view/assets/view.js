"use strict";
// The part of the world that a canvas shows: fit, follow, pan, zoom, pinch, ruler and picking. scene.js draws it.
// Positions are in cm.

// The width of the view around the ego vehicle.
const AROUND_EGO_M = 110;

class View {
  constructor(canvas, options = {}) {
    this.canvas = canvas;
    this.options = Object.assign({ interactive: true, regions: true, onPick: null }, options);
    this.context = canvas.getContext("2d");
    this.colors = palette();
    this.scene = null;
    this.follow = null;
    this.selected = null;
    this.ruler = null; // while it is on: its two ends
    this.center = null; // in m
    this.scale = 6; // pixels per metre
    this.fitted = false;
    this.pointers = new Map();
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

  request() {
    if (this.requested) return;
    this.requested = true;
    requestAnimationFrame(() => {
      this.requested = false;
      this.draw();
    });
  }

  // Fits all agents and the ends of their forecasts; with the ego vehicle in the middle, what is near it.
  fit() {
    if (this.follow === "ego" && this.scene && this.scene.ego) {
      this.center = this.scene.ego.slice(0, 2);
      this.scale = Math.min(this.width, this.height) / AROUND_EGO_M;
      this.fitted = true;
      this.moved = false;
      return;
    }
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
}
