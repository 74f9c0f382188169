// Speed above, margin below, over the same time; overrides as bars between them.
const chart = document.getElementById("timeline"), ink = chart.getContext("2d");
const AXIS = 52, RIGHT = 10, BAR = 12;
const speeds = frames.map((f) => value(f.speed)), margins = frames.map((f) => value(f.margin));
const finite = (list) => list.filter(Number.isFinite);
const bounds = (list, low) => {
  const known = finite(list);
  return [Math.min(low, ...known), Math.max(low + 1, ...known)];
};
const speedBounds = bounds(speeds, 0), marginBounds = bounds(margins, 0);
const last = frames.length - 1;
let plotted = { width: 0, height: 0 };

const chartX = (k) => AXIS + ((plotted.width - AXIS - RIGHT) * k) / Math.max(1, last);
const frameAt = (x) => Math.min(last, Math.max(0, Math.round(((x - AXIS) / (plotted.width - AXIS - RIGHT)) * last)));

function curve(list, [low, high], top, height, color) {
  const y = (v) => top + height - ((v - low) / (high - low)) * height;
  ink.strokeStyle = color;
  ink.lineWidth = 2;
  ink.beginPath();
  let drawn = false;
  list.forEach((v, k) => {
    if (!Number.isFinite(v)) { drawn = false; return; }
    if (drawn) ink.lineTo(chartX(k), y(v)); else ink.moveTo(chartX(k), y(v));
    drawn = true;
  });
  ink.stroke();
  return y;
}

function axis(name, suffix, [low, high], top, height) {
  ink.fillStyle = colors.pale;
  ink.font = "11px system-ui, sans-serif";
  ink.textAlign = "right";
  ink.textBaseline = "middle";
  ink.fillText(show(high, high < 10 ? 1 : 0), AXIS - 6, top + 4);
  ink.fillText(show(low, Math.abs(low) < 10 && low !== 0 ? 1 : 0), AXIS - 6, top + height - 3);
  ink.textAlign = "left";
  ink.fillText(name, 6, top + height / 2 - 7);
  ink.fillText(suffix, 6, top + height / 2 + 7);
  ink.strokeStyle = colors.rule;
  ink.lineWidth = 1;
  ink.strokeRect(AXIS, top, plotted.width - AXIS - RIGHT, height);
}

function drawTimeline(k) {
  const [width, height] = fit(chart, ink);
  plotted = { width, height };
  ink.clearRect(0, 0, width, height);
  const room = (height - BAR - 44) / 2, top = 8, bars = top + room + 6, below = bars + BAR + 6;
  axis("Speed", "m/s", speedBounds, top, room);
  axis("Margin", "m", marginBounds, below, room);
  ink.save();
  for (let i = 0; i < last; i += 1) {
    const kind = kindOf[frames[i].status];
    if (kind !== "changed" && kind !== "fallback") continue;
    ink.fillStyle = colors[kind];
    ink.fillRect(chartX(i), bars, Math.max(1.5, chartX(i + 1) - chartX(i) + 0.3), BAR);
    ink.globalAlpha = 0.1;
    ink.fillRect(chartX(i), top, chartX(i + 1) - chartX(i), 2 * room + BAR + 12);
    ink.globalAlpha = 1;
  }
  for (const at of jumps) {
    ink.fillStyle = colors.ink;
    ink.fillRect(chartX(at) - 0.5, bars - 2, 1.5, BAR + 4);
  }
  ink.restore();
  curve(speeds, speedBounds, top, room, colors.accent);
  const y = curve(margins, marginBounds, below, room, colors.area);
  ink.setLineDash([4, 4]);
  ink.strokeStyle = colors.fallback;
  ink.lineWidth = 1;
  ink.beginPath();
  ink.moveTo(AXIS, y(0));
  ink.lineTo(width - RIGHT, y(0));
  ink.stroke();
  ink.setLineDash([]);
  ink.fillStyle = colors.pale;
  ink.textBaseline = "alphabetic";
  const end = value(frames[last].time), every = [1, 2, 5, 10, 20, 60].find((s) => end / s <= width / 70) || 120;
  ink.textAlign = "center";
  for (let t = 0; t <= end + 1e-9; t += every) ink.fillText(`${t} s`, Math.min(chartX((t / end) * last), width - 16), height - 5);
  ink.strokeStyle = colors.ink;
  ink.lineWidth = 2;
  ink.beginPath();
  ink.moveTo(chartX(k), 4);
  ink.lineTo(chartX(k), height - 18);
  ink.stroke();
}
