// Ticks as the server sends them: an intersection with a crossing pair, and a car that drives away with the ego.
window.fixture = {
  agent(id, type, [x, y], [vx, vy], cause, more = {}) {
    const points = Array.from({ length: 12 }, (_, k) => [vx * 0.4 * (k + 1), vy * 0.4 * (k + 1)].map(Math.round)).flat();
    const modes = more.modes || [[700, points], [285, points.map((v, k) => (k % 2 ? v + 20 * k : v))], [15, points.map((v, k) => (k % 2 ? v - 60 * k : v))]];
    const end = (p, flat) => [p, flat[flat.length - 2], flat[flat.length - 1], 40000, 0, 40000];
    return {
      i: String(id), n: String(id), t: type, p: [x, y].map(Math.round), v: [vx, vy].map(Math.round), h: Math.round(Math.atan2(vy, vx) * 1000),
      s: type === 0 ? [450, 190] : [0, 0], u: 0, y: [null, null, -Math.round(vx * 0.4), -Math.round(vy * 0.4)],
      f: { q: cause ? 2 : 0, c: cause, a: 0, b: points, m: modes, e: modes.map(([p, flat]) => end(p, flat)), x: cause === 5 ? [100, 180, 720] : [700, 300, 0], o: 3 },
    };
  },
  tick(seq, more = {}) {
    const t = 1000 + seq * 0.08;
    const phase = (seq % 250) * 0.08;
    const at = (from, v) => from + v * phase;
    const agents = [
      fixture.agent(11, 0, [at(-4000, 800), 0], [800, 0], 0),
      fixture.agent(12, 0, [0, at(-4400, 800)], [0, 800], 5),
      fixture.agent(13, 2, [1500, at(-600, 120)], [0, 120], 4),
      ...(more.extra || []),
    ];
    return { missed: 0, scene: { seq, t, dt: 0.4, ego: more.ego === undefined ? null : more.ego, l: 12, r: {}, d: 0, agents, ...more.scene } };
  },
  feed(from, to, more = () => ({})) {
    for (let seq = from; seq < to; seq++) takeTick(fixture.tick(seq, more(seq)));
    showDetails();
  },
  // The colour at a place of the scene.
  pixel([x, y], [dx, dy] = [0, 0]) {
    sceneCanvas.draw();
    const [sx, sy] = sceneCanvas.toScreen(x, y);
    const { ratio } = sceneCanvas;
    return "#" + [...sceneCanvas.context.getImageData(Math.round((sx + dx) * ratio), Math.round((sy + dy) * ratio), 1, 1).data.slice(0, 3)]
      .map((value) => value.toString(16).padStart(2, "0")).join("");
  },
  parts: (color) => color.match(/[0-9a-f]{2}/gi).map((value) => parseInt(value, 16)),
  isNear: (a, b) => fixture.parts(a).every((value, at) => Math.abs(value - fixture.parts(b)[at]) < 25),
  // The number of pixels near a colour; within some pixels of a place of the scene if one is named.
  pixels(color, near = 30, [x, y, within] = []) {
    sceneCanvas.draw();
    const wanted = fixture.parts(color);
    const { ratio, canvas } = sceneCanvas;
    const [sx, sy] = within ? sceneCanvas.toScreen(x, y).map((value) => Math.round((value - within) * ratio)) : [0, 0];
    const size = within ? [2 * within * ratio, 2 * within * ratio] : [canvas.width, canvas.height];
    const { data } = sceneCanvas.context.getImageData(sx, sy, ...size);
    let count = 0;
    for (let at = 0; at < data.length; at += 4) {
      if (Math.abs(data[at] - wanted[0]) + Math.abs(data[at + 1] - wanted[1]) + Math.abs(data[at + 2] - wanted[2]) < near) count++;
    }
    return count;
  },
  // A colour over another one, as `#rrggbb`.
  over: (color, ground, opacity) => "#" + fixture.parts(color)
    .map((value, at) => Math.round(value * opacity + fixture.parts(ground)[at] * (1 - opacity)).toString(16).padStart(2, "0")).join(""),
};
