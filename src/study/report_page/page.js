"use strict";
// Puts the page together from the data in it: what went wrong first, then what was learned, how it moved, how long it
// took, and what is needed to do it again.

const data = JSON.parse(document.getElementById("data").textContent);
const compares = data.runs.length > 1;
const COLOURS = 6;
const colour = i => `var(--c${i % COLOURS})`;
const redraws = [];

const section = (name, ...children) => make("section", {class: name}, ...children.filter(child => child != null));
const row = (label, ...cells) => make("tr", {}, make("th", {}, label), ...cells);
const number = text => make("td", {class: "n"}, text);
const words = text => make("td", {class: "text"}, text);

function table(heads, rows) {
  const head = make("tr", {}, ...heads.map((text, i) => make("th", i ? {class: "n"} : {}, text)));
  return make("table", {}, ...(heads.length ? [head] : []), ...rows);
}

function outcome(summary) {
  const {ended, ticks, ticks_planned: planned, seconds} = summary;
  const how = ended === "complete" ? "complete" : ended === "failed" ? "failed" : `ended by signal ${ended.signal}`;
  const of = planned && planned !== ticks ? ` of ${thousands(planned)}` : "";
  return `${how}: ${thousands(ticks)}${of} ticks in ${short(seconds)} s`;
}

// What a person should know before the rest.
function problems({summary, notes}) {
  const found = [...notes];
  if (!summary) return found;
  if (summary.failure) found.push(summary.failure);
  for (const {name, text} of summary.warnings) found.push(`${name}: ${text}`);
  for (const {process, away_s: away, what} of summary.restarts) {
    found.push(`The ${process} was started again after ${short(away)} s: ${what}`);
  }
  for (const [name, count] of [["missed", summary.missed], ["late", summary.late], ["skipped", summary.skipped],
    ["lost", summary.lost], ["not a number", summary.non_finite], ["heard nothing", summary.unheard]]) {
    if (count) found.push(`${name}: ${thousands(count)} of ${thousands(summary.ticks)} ticks`);
  }
  for (const fault of summary.faults) found.push(`on purpose: ${fault}`);
  return found;
}

function progress({summary, error_unit: unit}) {
  if (!summary) return null;
  if (!summary.progress.length) {
    const windows = [["first", summary.first], ["last", summary.last]].filter(([, window]) => window);
    if (!windows.length) return null;
    const rows = windows.map(([name, w]) => row(`${name} ${thousands(w.ticks)} ticks`, number(short(w.loss)),
      number(short(w.end_error_m))));
    return section("", make("h3", {}, "What was learned"),
      table(["", "loss a tick", `error at a target's end${unit && ` (${unit})`}`], rows));
  }
  const rows = summary.progress.map(p => row(p.when, number(short(p.test_error_m)), number(short(p.optimum_error_m)),
    number(short(p.loss)), number(short(p.optimum_loss))));
  return section("", make("h3", {}, "What was learned"),
    table(["", "test error (m)", "optimum (m)", "loss a tick", "optimum"], rows),
    make("p", {}, summary.reached_text ? `${summary.reached_text}.` : ""));
}

// The movements of an arm, with controls.
function animation({log}) {
  const movements = log && log.movements;
  if (!movements || !movements.length) return null;
  const points = movements.flatMap(({poses}) => poses.flatMap(([, points, target]) => [...points, target]));
  const [xs, ys] = [0, 1].map(i => points.map(point => point[i]));
  const span = list => list.reduce(([low, high], v) => [Math.min(low, v), Math.max(high, v)], [Infinity, -Infinity]);
  const [[left, right], [bottom, top]] = [span(xs), span(ys)];
  const frame = {x: (left + right) / 2, y: (bottom + top) / 2, half: 0.55 * Math.max(right - left, top - bottom, 1)};
  const canvas = make("canvas", {"aria-label": "how the arm moved"});
  const choice = make("select", {"aria-label": "which ticks"}, ...movements.map(({label}, i) =>
    make("option", {value: i}, label)));
  const play = make("button", {type: "button"}, "pause");
  const slider = make("input", {type: "range", min: 0, value: 0, "aria-label": "tick"});
  const at = make("output");
  let playing = !matchMedia("(prefers-reduced-motion: reduce)").matches, began = null;
  const poses = () => movements[choice.value].poses;
  const draw = () => {
    const i = Number(slider.value), list = poses();
    drawArm(canvas, frame, list[i], list.slice(Math.max(0, i - 20), i + 1));
    at.textContent = `tick ${thousands(list[i][0])}`;
    play.textContent = playing ? "pause" : "play";
  };
  const select = () => {
    slider.max = poses().length - 1;
    slider.value = 0;
    began = null;
    draw();
  };
  const frameAt = now => {
    if (playing) {
      began = began ?? now - Number(slider.value) * log.period_s * 1000;
      const i = Math.floor((now - began) / 1000 / log.period_s) % poses().length;
      if (i !== Number(slider.value)) {
        slider.value = i;
        draw();
      }
    }
    requestAnimationFrame(frameAt);
  };
  choice.addEventListener("change", select);
  slider.addEventListener("input", () => { playing = false; draw(); });
  play.addEventListener("click", () => { playing = !playing; began = null; draw(); });
  redraws.push(draw);
  requestAnimationFrame(now => { select(); frameAt(now); });
  const controls = make("div", {class: "controls"}, choice, play, slider, at);
  return section("", make("h3", {}, "How it moved"), canvas, controls);
}

function latency({summary, log}) {
  const series = (log && log.latencies || []).map(({name, bins}, i) => ({name, bins, colour: colour(i)}));
  const rows = summary ? [["wake-up lateness", summary.wake_up_lateness_us],
    ["observation to command", summary.observation_to_command_us],
    ["command to applied", summary.command_to_applied_us]].filter(([, p]) => p) : [];
  if (!rows.length && !series.some(({bins}) => bins.length)) return null;
  return section("", histograms("Latency", series), table(["us", "p50", "p99", "p99.9", "max"], rows.map(([name, p]) =>
    row(name, ...[p.p50, p.p99, p.p999, p.max].map(us => number(short(us)))))));
}

function figure({figure}) {
  if (!figure) return null;
  const image = make("img", {alt: "loss and errors over time, first and last reach"});
  image.src = `data:image/svg+xml,${encodeURIComponent(figure)}`;
  return section("wide", make("h3", {}, "Figure"), image);
}

function again({summary, facts, settings}) {
  const rows = facts.map(([label, value]) => row(label, words(value)));
  if (summary) {
    rows.unshift(row("how it went", words(outcome(summary))), row("mode", words(summary.mode)),
      row("seed", words(String(summary.seed))), row("weights", words(summary.weights_hash ?? "none")));
  }
  return section("", make("h3", {}, "Versions and settings"), table([], rows),
    settings ? make("details", {}, make("summary", {}, "scenario.toml, every default filled in"),
      make("pre", {}, settings)) : null);
}

function one(run) {
  const wrong = problems(run), {log, marks} = run;
  const curve = (title, label, y) => log && curves(title, label,
    [{name: title, colour: colour(0), t: log.curves.t, y}], marks || []);
  const drawn = [curve("Loss, mean", "loss a tick", log && log.curves.loss),
    curve("Error, mean", run.error_unit ? `error (${run.error_unit})` : "error", log && log.curves.error)];
  const title = run.summary ? `${run.name}: ${run.summary.scenario}, ${run.summary.mode}, seed ${run.summary.seed}`
    : run.name;
  return make("article", {class: compares ? "run" : "run alone"}, make("h2", {}, title),
    section(`wide ${wrong.length ? "wrong" : ""}`, make("h3", {}, "What went wrong"), wrong.length
      ? make("ul", {}, ...wrong.map(text => make("li", {}, text))) : make("p", {}, "Nothing that is known.")),
    ...[progress(run), animation(run), ...(compares ? [] : drawn).map(d => d && section("", d)), latency(run),
      again(run), figure(run)].filter(part => part));
}

// Several runs in one table and one picture.
function shared() {
  const runs = data.runs;
  const cell = value => number(value == null ? "-" : typeof value === "number" ? short(value) : String(value));
  const of = pick => runs.map(run => cell(run.summary ? pick(run.summary) : null));
  const last = s => s.progress.length ? s.progress[s.progress.length - 1] : null;
  const rows = [
    row("how it ended", ...of(s => typeof s.ended === "string" ? s.ended : "by a signal")),
    row("scenario", ...of(s => s.scenario)), row("mode", ...of(s => s.mode)), row("seed", ...of(s => String(s.seed))),
    row("ticks", ...of(s => s.ticks)), row("ticks a second", ...of(s => s.ticks_per_second)),
    row("loss a tick, last twentieth", ...of(s => s.loss_per_tick)),
    row("test error at the end (m)", ...of(s => last(s)?.test_error_m)),
    row("optimum (m)", ...of(s => last(s)?.optimum_error_m)),
    ...["p50", "p99"].map(p => row(`observation to command, ${p} (us)`, ...of(s => s.observation_to_command_us?.[p]))),
    row("missed", ...of(s => s.missed)), row("lost", ...of(s => s.lost)),
    row("restarts", ...of(s => s.restarts.length)),
    row("weights", ...of(s => s.weights_hash)),
  ];
  const series = pick => runs.map((run, i) => run.log &&
    {name: run.name, colour: colour(i), t: run.log.curves.t, y: pick(run.log.curves)}).filter(Boolean);
  const units = new Set(runs.map(run => run.error_unit));
  const unit = units.size === 1 && [...units][0] ? ` (${[...units][0]})` : "";
  return [section("shared", make("h3", {}, "Side by side"), table(["", ...runs.map(run => run.name)], rows)),
    ...[curves("Loss, mean", "loss a tick", series(c => c.loss), []),
      curves("Error, mean", `error${unit}`, series(c => c.error), [])].map(d => d && section("shared", d))]
    .filter(Boolean);
}

function switchTheme() {
  const dark = getComputedStyle(document.documentElement).colorScheme.includes("dark");
  document.documentElement.dataset.theme = dark ? "light" : "dark";
  redraws.forEach(draw => draw());
}

const heading = make("h1", {}, compares ? `${data.runs.length} runs` : `Run ${data.runs[0].name}`);
document.getElementById("main").append(heading, ...(compares ? shared() : []),
  make("div", {class: compares ? "runs" : ""}, ...data.runs.map(one)));
const theme = make("button", {type: "button"}, "dark or light");
theme.addEventListener("click", switchTheme);
document.getElementById("footer").append(`Made by tectum ${data.build}. `, theme);
addEventListener("keydown", event => { if (event.key === "d" && !event.ctrlKey) switchTheme(); });
addEventListener("resize", () => redraws.forEach(draw => draw()));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => redraws.forEach(draw => draw()));
document.documentElement.dataset.ready = "true";
