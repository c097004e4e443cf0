"use strict";
// The regions that hold 50 % and 90 % of a forecast's probability: the density of its modes on a grid, and its contours.

// The modes of a mixture at the end of the horizon, for densities, and the box around three standard deviations.
function shapeOf(mixture) {
  const box = [Infinity, Infinity, -Infinity, -Infinity];
  const modes = [];
  let narrowest = Infinity;
  for (const [p, x, y, xx, xy, yy] of mixture) {
    const determinant = xx * yy - xy * xy;
    if (!(determinant > 0) || p < 4) continue;
    const [sx, sy] = [3 * Math.sqrt(xx), 3 * Math.sqrt(yy)];
    [box[0], box[1]] = [Math.min(box[0], x - sx), Math.min(box[1], y - sy)];
    [box[2], box[3]] = [Math.max(box[2], x + sx), Math.max(box[3], y + sy)];
    modes.push([p / Math.sqrt(determinant), x, y, yy / determinant / 2, -xy / determinant, xx / determinant / 2, sx, sy]);
    // The smaller standard deviation: narrow modes need a fine grid, unless they hardly matter.
    if (p >= 20) narrowest = Math.min(narrowest, Math.sqrt((xx + yy) / 2 - Math.hypot((xx - yy) / 2, xy)));
  }
  return { modes, box, narrowest };
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
    const drop = Math.exp(-a * dx * dx);
    const bend = drop * drop;
    for (let row = row0; row <= row1; row++) {
      const v = y0 + row * dy - y;
      // From the cell with the most, to both sides. The ratio of neighbours changes by a constant factor.
      const peak = Math.min(Math.max(Math.round((x - b * v / (2 * a) - x0) / dx), col0), col1);
      const u = x0 + peak * dx - x;
      const most = weight * Math.exp(-(a * u * u + b * u * v + c * v * v));
      const tilt = Math.exp(-dx * (2 * a * u + b * v));
      const at = row * cells;
      values[at + peak] += most;
      let [value, ratio] = [most, drop * tilt];
      for (let col = peak + 1; col <= col1 && value > least; col++) {
        values[at + col] += value *= ratio;
        ratio *= bend;
      }
      [value, ratio] = [most, drop / tilt];
      for (let col = peak - 1; col >= col0 && value > least; col--) {
        values[at + col] += value *= ratio;
        ratio *= bend;
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

// Adds the regions of a mixture around `origin` to the paths of both levels. `pixel` is the length of a pixel.
function addRegions(paths, mixture, origin, pixel) {
  const shape = shapeOf(mixture);
  if (!shape.modes.length) return;
  const side = Math.max(shape.box[2] - shape.box[0], shape.box[3] - shape.box[1]);
  // A cell has at least five pixels. Wide modes need no finer one than most of their deviation.
  const cell = Math.max(5 * pixel, Math.min(0.8 * shape.narrowest, side));
  const density = densityOf(shape, Math.min(Math.max(Math.ceil(side / cell) + 3, 12), CELLS_MAX));
  density.levels.forEach((level, place) => traceRegion(paths[place], density, level, origin));
}
