"use strict";
// The page's state: what the server has sent, and which tick is shown.

const KEPT = 6000, PATH = 60;
const $ = id => document.getElementById(id);
const state = {run: null, now: null, records: [], events: [], curves: null, marks: [], at: null, fresh: false,
  connected: false};
const plots = {
  loss: new CurvePlot($("loss"), ["--loss"], {names: ["loss"]}),
  error: new CurvePlot($("error"), ["--error"], {names: ["error"]}),
  targets: new CurvePlot($("targets"), ["--loss", "--error"], {names: ["mean loss", "error at the end"],
    series: {points: {show: true, size: 4}, width: 0.7}}),
  latency: new CurvePlot($("latency"), ["--loss", "--path"], {names: ["answer", "sensing"], linear: true,
    scale: {distr: 3}, ticks: (u, all) => all.map(v => v == null ? "" : micros(v)),
    x: {label: "from", value: (u, v) => v == null ? "" : micros(v)},
    series: {paths: uPlot.paths.bars({size: [0.8]}), fill: "#8884"}}),
};
let drawing = false;

function takeHello(run) {
  Object.assign(state, {run, now: null, records: [], events: [], curves: null, marks: [], at: null});
  $("name").textContent = run.name;
  document.title = `${run.name} - tectum watch`;
  $("what").textContent = `${run.scenario}, ${run.realtime ? "real time" : "lockstep"}, seed ${run.seed}`;
  $("error-section").hidden = !run.has_error;
  $("error-title").textContent = run.error_unit ? `error (${run.error_unit})` : "error";
  $("plant-title").textContent = run.arm ? "arm, target, path of its end" : "inputs, and commands applied";
  $("arm").hidden = !run.arm;
  $("bars").hidden = !!run.arm;
  $("budget-title").textContent = `tick budget, of ${micros(run.period_s * 1e6)}`;
  for (const section of document.querySelectorAll(".realtime")) section.hidden = !run.realtime;
  $("events").replaceChildren();
}

function takeUpdate(update) {
  state.now = update;
  state.records.push(...update.records);
  const extra = Math.max(0, state.records.length - KEPT);
  state.records.splice(0, extra);
  if (state.at != null) state.at = Math.max(0, state.at - extra);
  for (const event of update.events) takeEvent(event);
  if (update.curves) [state.curves, state.fresh] = [update.curves, true];
}

function takeEvent(event) {
  // An entry that counts on takes the place of the one before.
  const known = state.events.findIndex(e => e.kind === event.kind && e.text === event.text && e.tick === event.tick
    && event.count > 1);
  if (known >= 0) {
    state.events[known].row.remove();
    state.events.splice(known, 1);
  }
  const row = document.createElement("li"), tick = document.createElement("span"), text = document.createElement("div");
  tick.textContent = thousands(event.last);
  text.textContent = event.text + (event.count > 1
    ? ` (${thousands(event.count)} times since tick ${thousands(event.tick)})` : "");
  row.className = event.kind;
  row.append(tick, text);
  $("events").prepend(row);
  state.events.push({...event, row});
  if (state.events.length > 200) state.events.shift().row.remove();
  if (event.kind === "change" || event.kind === "restart") {
    state.marks.push({at: event.tick * state.run.period_s, kind: event.kind});
  }
}

function shown() {
  const last = state.records.length - 1;
  return Math.min(state.at ?? last, last);
}

function draw() {
  drawing = false;
  const {run, now, records} = state;
  if (!run || !now) return;
  const i = shown();
  if (i >= 0) {
    if (run.arm && records[i].p.length) {
      drawArm($("arm"), run.arm, records[i], records.slice(Math.max(0, i - PATH), i + 1));
    } else {
      drawBars($("bars"), [...run.inputs, ...run.outputs], [...records[i].x, ...records[i].u]);
    }
    $("time").max = records.length - 1;
    $("time").value = i;
    $("at").textContent = seconds(records[i].t * run.period_s);
  }
  $("pause").textContent = state.at == null ? "pause" : "now";
  drawState(run, now);
  drawCurves(run);
}

function drawState(run, now) {
  $("progress").value = now.tick / run.ticks;
  $("done").textContent = `tick ${thousands(now.tick)} of ${thousands(now.ticks)}, ${short(now.rate)} ticks/s`
    + (now.left_s == null ? "" : `, ${seconds(now.left_s)} left`);
  $("status").textContent = !state.connected ? "connection lost, trying again" : now.ended ?? "running";
  const cell = (text, kind) => {
    const td = document.createElement("td");
    td.textContent = text;
    if (kind) td.className = kind;
    return td;
  };
  const rows = (id, all) => $(id).tBodies[0].replaceChildren(...all.map(cells => {
    const tr = document.createElement("tr");
    tr.append(...cells);
    return tr;
  }));
  rows("processes", now.processes.map(p => [cell(p.name), cell(p.state, p.bad ? "bad" : ""),
    cell(p.start > 1 ? `start ${p.start}` : ""), cell(p.pid ? `pid ${p.pid}` : "", "n")]));
  const [plant, controller, logger] = now.processes;
  $("counts").textContent = `missed ${thousands(plant.missed)}, late ${thousands(plant.late)}, `
    + `skipped ${thousands(plant.lost)}, lost by logger ${thousands(logger.lost)}, by controller `
    + `${thousands(controller.lost)}; seen here ${thousands(now.taken)} ticks, passed over `
    + thousands(now.passed_over);
  rows("budget", now.stages.map(s => {
    const share = cell("", "share"), bar = document.createElement("i");
    bar.style.width = `${s.us ? Math.min(100, s.us.p50 / run.period_s / 1e4) : 0}%`;
    share.append(bar);
    const slack = s.name === "slack";
    const tail = s.us ? `${slack ? "p1" : "p99"} ${micros(slack ? s.us.p1 : s.us.p99)}` : "-";
    return [cell(s.name), share, cell(`p50 ${micros(s.us?.p50)}`, "n"), cell(tail, "n")];
  }));
}

function drawCurves(run) {
  const curves = state.curves;
  if (!curves || !state.fresh) return;
  state.fresh = false;
  const inSeconds = ([ticks, values]) => [ticks.map(t => t * run.period_s), values];
  plots.loss.show(inSeconds(curves.loss), state.marks);
  if (run.has_error) plots.error.show(inSeconds(curves.error), state.marks);
  const targets = curves.targets;
  plots.targets.show([targets.map(t => t[0] * run.period_s), targets.map(t => t[1]), targets.map(t => t[2])],
    state.marks);
  if (run.realtime) {
    plots.latency.show([curves.answer.map(b => b[0]), curves.answer.map(b => b[1]), curves.sensing.map(b => b[1])], []);
  }
}

function redraw() {
  if (!drawing) {
    drawing = true;
    requestAnimationFrame(draw);
  }
}

function pause() {
  state.at = state.at == null ? shown() : null;
  redraw();
}

function step(by) {
  const at = shown() + by;
  state.at = at >= state.records.length - 1 ? null : Math.max(0, at);
  redraw();
}

function toggleTheme() {
  const dark = getComputedStyle(document.documentElement).colorScheme === "dark";
  document.documentElement.dataset.theme = dark ? "light" : "dark";
  state.fresh = true;
  redraw();
}

$("pause").onclick = pause;
$("theme").onclick = toggleTheme;
$("time").oninput = () => { state.at = Number($("time").value); redraw(); };
document.addEventListener("keydown", event => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const steps = {ArrowLeft: -1, ArrowRight: 1}[event.key];
  if (steps) step(steps * (event.shiftKey ? 20 : 1));
  else if (event.key === " " && event.target.tagName !== "BUTTON") pause();
  else if (event.key === "End") { state.at = null; redraw(); }
  else if (event.key === "d") toggleTheme();
  else return;
  event.preventDefault();
});
window.addEventListener("resize", () => { state.fresh = true; redraw(); });

const source = new EventSource("events" + location.search);
source.onopen = () => { state.connected = true; redraw(); };
source.onerror = () => { state.connected = false; redraw(); };
source.onmessage = message => {
  const data = JSON.parse(message.data);
  if (data.kind === "hello") takeHello(data); else if (data.kind === "update") takeUpdate(data);
  else $("status").textContent = data.text;
  redraw();
};
// For tests.
window.watched = state;
