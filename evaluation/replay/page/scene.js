// The road around the ego, seen from above; y points down, as in highway-env.
const canvas = document.getElementById("scene"), pen = canvas.getContext("2d");
let colors = {};
const view = { zoom: 1, scale: 1, x: 0, y: 0, width: 0, height: 0 };

function readColors() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["paper", "card", "ink", "pale", "rule", "grass", "asphalt", "marking", "kerb", "body", "body-edge",
    "passed", "changed", "fallback", "ghost", "area", "bind", "accent"]) colors[name] = style.getPropertyValue(`--${name}`).trim();
}

/** A canvas as large as its box, in device pixels; its pen then draws in CSS pixels. */
function fit(element, context) {
  const ratio = window.devicePixelRatio || 1, box = element.getBoundingClientRect();
  const [w, h] = [Math.round(box.width * ratio), Math.round(box.height * ratio)];
  if (element.width !== w || element.height !== h) [element.width, element.height] = [w, h];
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return [box.width, box.height];
}

const toX = (x) => view.width / 2 + (x - view.x) * view.scale;
const toY = (y) => view.height / 2 + (y - view.y) * view.scale;

function trace(points, close = false) {
  pen.beginPath();
  points.forEach(([x, y], i) => (i ? pen.lineTo(toX(x), toY(y)) : pen.moveTo(toX(x), toY(y))));
  if (close) pen.closePath();
}

/** The part of a segment that is in view: a dashed line of kilometres is slow. */
function clipped([ax, ay], [bx, by]) {
  const dx = bx - ax, dy = by - ay, length = Math.hypot(dx, dy);
  if (length === 0) return null;
  const reach = Math.hypot(view.width, view.height) / view.scale;
  const at = ((view.x - ax) * dx + (view.y - ay) * dy) / length;
  const from = Math.max(0, at - reach), to = Math.min(length, at + reach);
  if (to <= from) return null;
  const on = (s) => [ax + (dx * s) / length, ay + (dy * s) / length];
  return { from, points: [on(from), on(to)] };
}

function drawLine(points, kind) {
  if (kind === 0) return;
  pen.strokeStyle = kind === 1 ? colors.marking : colors.kerb;
  pen.lineWidth = Math.max(1, 0.15 * view.scale);
  pen.setLineDash(kind === 1 ? [3 * view.scale, 5 * view.scale] : []);
  if (points.length === 2) {
    const part = clipped(points[0], points[1]);
    if (part) {
      pen.lineDashOffset = part.from * view.scale;
      trace(part.points);
      pen.stroke();
    }
  } else {
    pen.lineDashOffset = 0;
    trace(points);
    pen.stroke();
  }
  pen.setLineDash([]);
}

function drawRoad() {
  pen.fillStyle = colors.asphalt;
  pen.strokeStyle = colors.asphalt;
  pen.lineWidth = 1;
  for (const lane of edges) {
    trace([...lane.left, ...[...lane.right].reverse()], true);
    pen.fill();
    pen.stroke();
  }
  for (const lane of edges) {
    drawLine(lane.left, lane.lines[0]);
    drawLine(lane.right, lane.lines[1]);
  }
}

function drawAreas(override) {
  for (const area of override.areas) {
    const binds = area.body === override.cause && override.cause >= 0;
    trace(places(area.outline), true);
    pen.globalAlpha = binds ? 0.34 : 0.2;
    pen.fillStyle = binds ? colors.bind : colors.area;
    pen.fill();
    pen.globalAlpha = 0.9;
    pen.strokeStyle = pen.fillStyle;
    pen.lineWidth = binds ? 2 : 1;
    pen.stroke();
    pen.globalAlpha = 1;
  }
}

function drawBody(pose, size, { fill, edge, width = 1.2, alpha = 1, dash = [] }) {
  pen.save();
  pen.translate(toX(pose.x), toY(pose.y));
  pen.rotate(pose.heading);
  pen.scale(view.scale, view.scale);
  const { length, width: wide } = size;
  pen.globalAlpha = alpha;
  pen.beginPath();
  pen.roundRect(-length / 2, -wide / 2, length, wide, Math.min(0.5, wide / 4));
  if (fill) {
    pen.fillStyle = fill;
    pen.fill();
    pen.fillStyle = "rgba(0, 0, 0, 0.35)"; // a windscreen shows which end is the front
    pen.fillRect(length * 0.12, -wide * 0.38, length * 0.16, wide * 0.76);
  }
  pen.strokeStyle = edge;
  pen.lineWidth = width / view.scale;
  pen.setLineDash(dash.map((x) => x / view.scale));
  pen.stroke();
  pen.restore();
}

function drawPath(points, color, width, dash) {
  if (points.length < 2) return;
  pen.strokeStyle = color;
  pen.lineWidth = width;
  pen.lineJoin = pen.lineCap = "round";
  pen.setLineDash(dash);
  trace(points);
  pen.stroke();
  pen.setLineDash([]);
}

function label(text, x, y, color) {
  pen.font = "600 12px system-ui, sans-serif";
  pen.lineWidth = 3;
  pen.strokeStyle = colors.card;
  pen.strokeText(text, x, y);
  pen.fillStyle = color;
  pen.fillText(text, x, y);
}

function drawPlan(frame, ego, share, color) {
  const points = places(frame.plan);
  if (points.length < 2) return;
  const split = Math.min(points.length - 1, Math.max(1, Math.round(frame.until / frame.every)));
  points[0] = [ego.x, ego.y];
  drawPath(points.slice(split), color, 2, [1, 6]);
  drawPath(points.slice(0, split + 1), color, 3, []);
  const end = points[points.length - 1], apart = (p) => Math.hypot(end[0] - p[0], end[1] - p[1]) > 0.5;
  const before = points.findLast(apart);
  const heading = before ? Math.atan2(end[1] - before[1], end[0] - before[0]) : ego.heading;
  drawBody({ x: end[0], y: end[1], heading }, bodies[0], { edge: color, dash: [3, 3] });
}

function drawGhost(found, at) {
  const { path, near } = found, last = path.length / 3 - 1;
  const points = [];
  for (let k = 0; k <= last; k += 1) points.push([path[3 * k] * unit, path[3 * k + 1] * unit]);
  drawPath(points, colors.ghost, 2.5, [8, 6]);
  const k = Math.min(last, at);
  drawBody(poseIn(path, k), bodies[0], { fill: k > 0 ? colors.ghost : null, edge: colors.ghost, alpha: 0.8, width: 2 });
  if (k > 0 && near.length > 3 * k && found.body >= 0) {
    drawBody(poseIn(near, k), bodies[found.body], { edge: colors.ghost, width: 2, dash: [5, 4] });
  }
  if (found.crashed && k === last) {
    const [x, y] = [toX(points[last][0]), toY(points[last][1])];
    drawPath([], colors.fallback, 0, []);
    pen.strokeStyle = colors.fallback;
    pen.lineWidth = 4;
    pen.beginPath();
    for (const side of [-1, 1]) { pen.moveTo(x - 10, y - 10 * side); pen.lineTo(x + 10, y + 10 * side); }
    pen.stroke();
    label("crash", x + 14, y - 8, colors.fallback);
  }
}

/** The name of the binding vehicle; where it is out of view, a mark at the edge in its direction. */
function markBinding(pose, body) {
  const x = toX(pose.x), y = toY(pose.y), text = body.kind, wide = 8 * text.length;
  const inside = x > 0 && x < view.width && y > 0 && y < view.height;
  if (!inside) {
    const [px, py] = [Math.min(view.width - 12, Math.max(12, x)), Math.min(view.height - 12, Math.max(12, y))];
    pen.save();
    pen.translate(px, py);
    pen.rotate(Math.atan2(y - py, x - px));
    pen.fillStyle = colors.bind;
    pen.beginPath();
    pen.moveTo(10, 0);
    pen.lineTo(-8, -8);
    pen.lineTo(-8, 8);
    pen.fill();
    pen.restore();
  }
  const left = Math.min(view.width - wide - 6, Math.max(6, x - wide / 2));
  label(text, left, Math.min(view.height - 26, Math.max(46, y - body.width * view.scale * 0.5 - 8)), colors.bind);
}

function aim(ego) {
  [view.width, view.height] = fit(canvas, pen);
  const wide = Math.min(120, Math.max(62, view.width / 9));
  view.scale = (view.zoom * view.width) / wide;
  const ahead = replay.straight ? 0.28 * (view.width / view.scale) : 0;
  view.x = ego.x + ahead * Math.cos(ego.heading);
  view.y = ego.y + ahead * Math.sin(ego.heading);
  if (replay.straight) {
    const heading = Math.abs(Math.sin(ego.heading)) < 0.7;
    if (heading) view.y = middle;
  }
}
const middle = edges.length ? (Math.min(...edges.map((e) => e.left[0][1])) + Math.max(...edges.map((e) => e.right[0][1]))) / 2 : 0;

/** Frame k and a share of the way to the next; `ghost` is the frame of what would have happened, or null. */
function drawScene(k, share, ghost) {
  const frame = frames[k], next = frames[Math.min(k + 1, frames.length - 1)];
  const ego = between(frame, next, share), override = overrideAt(k);
  aim(ego);
  pen.fillStyle = colors.grass;
  pen.fillRect(0, 0, view.width, view.height);
  drawRoad();
  if (override) drawAreas(override);
  const now = othersAt(k), later = othersAt(Math.min(k + 1, frames.length - 1));
  const cause = override ? override.cause : -1;
  for (const [number, pose] of now) {
    const moved = later.has(number) ? between(pose, later.get(number), share) : pose, binds = number === cause;
    drawBody(moved, bodies[number], { fill: colors.body, edge: binds ? colors.bind : colors["body-edge"], width: binds ? 4 : 1.2 });
    if (binds) markBinding(moved, bodies[number]);
  }
  const kind = kindOf[frame.status], color = kind ? colors[kind] : colors.pale;
  drawPlan(frame, ego, share, color);
  if (override && override.what_if) drawGhost(override.what_if, ghost === null ? k - steps[override.step].first : ghost);
  drawBody(ego, bodies[0], { fill: color, edge: colors.ink, width: 1.5 });
}
