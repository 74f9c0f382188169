"use strict";
// The record of the episode. Numbers that are not finite are texts in JSON.
const replay = JSON.parse(document.getElementById("data").textContent);
const value = (x) => (typeof x === "string" ? Number(x) : x);
const { unit, turn, frames, steps, overrides, bodies, lanes } = replay;
const ofStep = new Map(overrides.map((o) => [o.step, o]));
const kindOf = { PASSED: "passed", "HELD BACK": "changed", OVERRIDE: "changed", FALLBACK: "fallback" };
// Throttle and steering are decided about many times a second: one entry for each row of overrides.
const goesOn = (k) => k > 0 && kindOf[frames[k - 1].status] !== "passed";
const listed = overrides.filter((o) => replay.about.actions !== "inputs" || !goesOn(o.frame));
const jumps = listed.map((o) => o.frame);

/** The override of the step that a frame belongs to, or undefined. */
const overrideAt = (k) => ofStep.get(frames[k].step);

/** A number for people: "–" where there is none, with a proper minus. */
function show(x, digits, suffix = "") {
  const n = value(x);
  if (Number.isNaN(n)) return "–";
  const text = Number.isFinite(n) ? n.toFixed(digits) : n > 0 ? "∞" : "−∞";
  return text.replace(/^-/, "−") + suffix;
}

/** The others in a frame by their number: x, y [m], heading [rad], speed [m/s]. */
function othersAt(k) {
  const flat = frames[k].others, found = new Map();
  for (let i = 0; i < flat.length; i += 5) {
    found.set(flat[i], { x: flat[i + 1] * unit, y: flat[i + 2] * unit, heading: flat[i + 3] * turn, speed: flat[i + 4] * unit });
  }
  return found;
}

const wrapped = (a) => Math.atan2(Math.sin(a), Math.cos(a));

/** Between two poses, for drawing alone. */
function between(a, b, share) {
  return {
    x: a.x + share * (b.x - a.x), y: a.y + share * (b.y - a.y),
    heading: a.heading + share * wrapped(b.heading - a.heading), speed: a.speed,
  };
}

/** Pose number k of a list of poses in their units. */
function poseIn(flat, k) {
  return { x: flat[3 * k] * unit, y: flat[3 * k + 1] * unit, heading: flat[3 * k + 2] * turn, speed: 0 };
}

/** Places in units, as pairs in metres. */
function places(flat) {
  const found = [];
  for (let i = 0; i < flat.length; i += 2) found.push([flat[i] * unit, flat[i + 1] * unit]);
  return found;
}
const edges = lanes.map((lane) => ({ left: places(lane.left), right: places(lane.right), lines: lane.lines }));
