// What is shown, and what moves it. The frame that is shown stands in data-frame of the document's root element.
const at = (id) => document.getElementById(id);
const state = { frame: 0, share: 0, playing: false, ghost: null, then: 0 };

/** Text for people, and beside it the value as it was recorded. */
function put(id, text, recorded = text) {
  const element = at(id);
  if (element.textContent !== text) element.textContent = text;
  element.dataset.value = String(recorded);
}

const readable = (word) => word.replaceAll("_", " ");
const named = (number) => (number < 0 ? "" : `${bodies[number].kind} ${number}`);

function describe() {
  const frame = frames[state.frame], step = frame.step < 0 ? null : steps[frame.step], override = overrideAt(state.frame);
  put("clock", `${show(frame.time, 2)} / ${show(frames[last].time, 1)} s`, state.frame);
  put("time", show(frame.time, 2, " s"), value(frame.time));
  put("speed", show(frame.speed, 2, " m/s"), value(frame.speed));
  put("proposed", step ? step.proposed : "–");
  put("executed", step ? step.executed : "–");
  put("acceleration", show(frame.acceleration, 2, " m/s²"), value(frame.acceleration));
  put("wheel", show((value(frame.wheel) * 180) / Math.PI, 2, "°"), value(frame.wheel));
  put("tier", step ? readable(frame.tier) : "–", frame.tier);
  put("reason", step ? readable(frame.reason) : "–", frame.reason);
  put("margin", show(frame.margin, 3, " m"), value(frame.margin));
  const binding = frame.binding >= 0 ? frame.binding : override ? override.cause : -1;
  put("binding", [frame.clause, named(binding)].filter(Boolean).join(", ") || "–", binding);
  put("guarantee", step ? step.guarantee : "–");
  put("status", frame.status || "END");
  at("status").className = `badge ${kindOf[frame.status] || "none"}`;
  put("explanation", step ? step.text : "The episode is over.");
  const found = override && override.what_if;
  at("what-if-box").hidden = !found;
  if (found) put("what-if", `${override.refused || step.proposed}, then ${found.then}: ${found.text}.`, value(found.gap));
  for (const button of at("overrides").querySelectorAll("button")) {
    const current = override !== undefined && Number(button.dataset.step) === override.step;
    if (current && button.getAttribute("aria-current") !== "true") {
      const list = at("overrides");
      list.scrollTop = button.offsetTop - list.offsetTop - list.clientHeight / 3;
    }
    button.setAttribute("aria-current", String(current));
  }
  at("scrubber").value = String(state.frame);
  at("scrubber").setAttribute("aria-valuetext", show(frame.time, 2, " s"));
  at("next").disabled = nextOverride(1) === undefined;
  at("previous").disabled = nextOverride(-1) === undefined;
  document.documentElement.dataset.frame = String(state.frame);
}

function render() {
  drawScene(state.frame, state.share, state.ghost);
  drawTimeline(state.frame + state.share);
}

function go(frame) {
  state.frame = Math.min(last, Math.max(0, frame));
  state.share = 0;
  state.ghost = null;
  describe();
  render();
}

function nextOverride(way) {
  return way > 0 ? jumps.find((k) => k > state.frame) : jumps.findLast((k) => k < state.frame);
}

function jump(way) {
  const frame = nextOverride(way);
  play(false);
  if (frame !== undefined) go(frame);
}

function play(on) {
  state.playing = on;
  put("play", on ? "Pause" : "Play");
  if (!on) { state.share = 0; return; }
  if (state.frame >= last) go(0);
  state.ghost = null;
  state.then = performance.now();
  requestAnimationFrame(advance);
}

const elapsed = (now) => {
  const frames = (Math.max(0, now - state.then) / 1000) * Number(at("rate").value) / value(replay.dt);
  state.then = now;
  return frames;
};

function advance(now) {
  if (!state.playing) return;
  const position = Math.min(last, state.frame + state.share + elapsed(now)), before = state.frame;
  state.frame = Math.floor(position);
  state.share = position - state.frame;
  if (state.frame !== before) describe();
  if (position >= last) play(false);
  render();
  if (state.playing) requestAnimationFrame(advance);
}

/** Play what would have happened, the rest standing still. */
function follow() {
  const override = overrideAt(state.frame);
  if (!override || !override.what_if) return;
  play(false);
  go(steps[override.step].first);
  state.then = performance.now();
  let position = 0;
  const end = override.what_if.path.length / 3 - 1;
  const tick = (now) => {
    if (position > 0 && state.ghost === null) return; // something else has been asked for
    position = Math.min(end, position + elapsed(now));
    state.ghost = Math.floor(position);
    render();
    if (position < end) requestAnimationFrame(tick);
  };
  requestAnimationFrame(tick);
}

function zoom(factor) {
  view.zoom = Math.min(6, Math.max(0.3, view.zoom * factor));
  render();
}

function heading() {
  const about = replay.about;
  put("title", `${about.setting} · ${about.policy} · seed ${about.seed}`);
  const outcome = at("outcome"), parts = [
    [about.crashed ? "crashed" : "no crash", about.crashed], [about.off_road ? "left the road" : "", true],
    [`${about.overridden} of ${about.steps} decisions overridden`, false],
    [`smallest margin ${show(about.min_margin, 2, " m")}`, value(about.min_margin) < 0],
    [`return ${show(about.return, 2)}`, false],
  ].filter(([text]) => text);
  parts.forEach(([text, bad], i) => {
    const bold = document.createElement("b");
    bold.textContent = text;
    if (bad) bold.className = "bad";
    outcome.append(i ? " · " : "", bold);
  });
  outcome.append(` · shield ${about.mode} at ${about.shield}, ${readable(about.verification)}`);
  if (about.verification === "simulated_traffic") put("areas", "where the others would be at the binding frame, as simulated");
  put("made", `${about.environment}. Driven with ${Object.entries(about.versions).map(([name, v]) => `${name} ${v}`).join(", ")}. ` +
    `Speeds, margins and inputs are those of the record, bit for bit; what is drawn is rounded to ${unit} m.`);
}

function listOverrides() {
  const list = at("overrides");
  if (!listed.length) list.append("Nothing was overridden.");
  for (const override of listed) {
    const item = document.createElement("li"), button = document.createElement("button");
    for (const [name, text] of [["time", show(frames[override.frame].time, 1, " s")], ["text", override.text]]) {
      const part = document.createElement("span");
      part.className = name;
      part.textContent = text;
      button.append(part);
    }
    button.dataset.step = String(override.step);
    button.dataset.frame = String(override.frame);
    if (steps[override.step].fallback) button.classList.add("fallback");
    button.addEventListener("click", () => { play(false); go(override.frame); });
    item.append(button);
    list.append(item);
  }
}

const KEYS = {
  " ": () => play(!state.playing), ArrowRight: () => move(1), ArrowLeft: () => move(-1),
  Home: () => move(-Infinity), End: () => move(Infinity), o: () => jump(1), p: () => jump(-1), w: follow,
  "+": () => zoom(1.25), "-": () => zoom(0.8),
};

function move(by) {
  play(false);
  go(state.frame + by);
}

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
  const long = event.shiftKey && event.key.startsWith("Arrow");
  const action = long ? () => move((event.key === "ArrowRight" ? 1 : -1) * Math.round(1 / value(replay.dt))) : KEYS[event.key];
  if (!action) return;
  event.preventDefault();
  action();
});
at("play").addEventListener("click", () => play(!state.playing));
at("next").addEventListener("click", () => jump(1));
at("previous").addEventListener("click", () => jump(-1));
at("follow").addEventListener("click", follow);
at("zoom-in").addEventListener("click", () => zoom(1.25));
at("zoom-out").addEventListener("click", () => zoom(0.8));
at("scrubber").max = String(last);
at("scrubber").addEventListener("input", (event) => { play(false); go(Number(event.target.value)); });
const seek = (event) => { if (event.buttons & 1) { play(false); go(frameAt(event.offsetX)); } };
chart.addEventListener("pointerdown", (event) => { chart.setPointerCapture(event.pointerId); seek(event); });
chart.addEventListener("pointermove", seek);
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { readColors(); render(); });
new ResizeObserver(render).observe(document.body);

document.body.classList.toggle("straight", replay.straight);
readColors();
heading();
listOverrides();
go(0);
document.documentElement.dataset.ready = "true";
