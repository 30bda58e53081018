"use strict";
// What is drawn: curves and histograms as SVG, the arm on a canvas. Each function draws what it is given.

const css = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const short = x => x == null ? "-" : x === 0 ? "0" : Math.abs(x) >= 1e6 || Math.abs(x) < 1e-3 ? x.toExponential(1)
  : Math.abs(x) >= 1000 ? Math.round(x).toLocaleString("en") : String(Number(x.toPrecision(3)));
const thousands = n => n == null ? "unknown" : n.toLocaleString("en");

function make(tag, attributes = {}, ...children) {
  const svg = ["svg", "path", "line", "rect", "text", "title", "g"].includes(tag);
  const element = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

// Round numbers from `low` to `high`, about `count` of them.
function ticks(low, high, count) {
  const rough = (high - low) / count, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map(n => n * power).find(step => step >= rough);
  const found = [];
  for (let i = Math.ceil(low / step); i * step <= high * (1 + 1e-9); i++) found.push(i * step);
  return found;
}

// Round numbers for a logarithmic axis: 1, 2 and 5 of each power of ten, or the powers alone where there are many.
function decades(low, high) {
  const found = [];
  for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power++) {
    found.push(...(high / low < 200 ? [1, 2, 5] : [1]).map(n => n * 10 ** power));
  }
  return found.filter(value => value >= low && value <= high);
}

const WIDE = 640, HIGH = 250, LEFT = 62, RIGHT = 12, TOP = 20, BOTTOM = 38;

// A frame with axes. `x` and `y` are {low, high, label, log}. Gives the SVG and the two scales.
function axes(x, y, title) {
  const svg = make("svg", {viewBox: `0 0 ${WIDE} ${HIGH}`, role: "img", "aria-label": title});
  const along = axis => value => axis.log ? Math.log10(Math.max(value, axis.low)) : value;
  const place = (axis, from, to) => {
    const [low, high] = [along(axis)(axis.low), along(axis)(axis.high)];
    return value => from + (to - from) * (along(axis)(value) - low) / (high - low || 1);
  };
  const px = place(x, LEFT, WIDE - RIGHT), py = place(y, HIGH - BOTTOM, TOP);
  const at = axis => axis.log
    ? decades(axis.low, axis.high)
    : ticks(axis.low, axis.high, 6);
  for (const value of at(y)) {
    svg.append(make("line", {class: "grid", x1: LEFT, x2: WIDE - RIGHT, y1: py(value), y2: py(value)}),
      make("text", {x: LEFT - 6, y: py(value) + 4, "text-anchor": "end"}, short(value)));
  }
  for (const value of at(x)) {
    svg.append(make("line", {class: "grid", x1: px(value), x2: px(value), y1: HIGH - BOTTOM, y2: HIGH - BOTTOM + 4}),
      make("text", {x: px(value), y: HIGH - BOTTOM + 16, "text-anchor": "middle"}, short(value)));
  }
  svg.append(make("text", {x: WIDE - RIGHT, y: HIGH - 4, "text-anchor": "end"}, x.label),
    make("text", {x: 4, y: 12}, y.label));
  return {svg, px, py};
}

// A key to the colours, off the data.
const legend = series => make("div", {class: "legend"}, ...series.map(({name, colour}) =>
  make("span", {}, make("i", {style: `background:${colour}`}), name)));

// Curves over time: `series` is a list of {name, colour, t, y}; `marks` of [seconds, label].
function curves(title, label, series, marks) {
  const shown = series.filter(({y}) => y && y.some(value => value != null));
  if (!shown.length) return null;
  const values = shown.flatMap(({y}) => y.filter(value => value != null));
  const [least, most] = [values, values].map((list, i) => list.reduce((a, b) => i ? Math.max(a, b) : Math.min(a, b)));
  const log = least > 0 && most / least > 20;
  const margin = (most - least) * 0.05 || Math.abs(most) * 0.05 || 1;
  const y = log ? {low: least, high: most, label, log} : {low: least - margin, high: most + margin, label};
  const end = Math.max(...shown.flatMap(({t}) => t));
  const {svg, px, py} = axes({low: 0, high: end, label: "time (s)"}, y, title);
  for (const [seconds, text] of marks.filter(([seconds]) => seconds <= end)) {
    const right = px(seconds) > WIDE / 2;
    svg.append(make("line", {class: "mark", x1: px(seconds), x2: px(seconds), y1: TOP, y2: HIGH - BOTTOM}),
      make("text", {class: "mark", x: px(seconds) + (right ? -4 : 4), y: TOP + 10,
        "text-anchor": right ? "end" : "start"}, text));
  }
  for (const {t, y, colour} of shown) {
    let d = "", down = false;
    y.forEach((value, i) => {
      if (value != null) d += `${down ? "L" : "M"}${px(t[i]).toFixed(1)} ${py(value).toFixed(1)}`;
      down = value != null;
    });
    svg.append(make("path", {d, fill: "none", stroke: colour, "stroke-width": 1.6, "stroke-linejoin": "round"}));
  }
  return make("div", {}, make("h3", {}, title), svg, ...(shown.length > 1 ? [legend(shown)] : []));
}

// Histograms over a logarithmic axis: `series` is a list of {name, colour, bins: [[us, count]]}.
function histograms(title, series) {
  const shown = series.filter(({bins}) => bins.length);
  if (!shown.length) return null;
  const step = 10 ** (1 / 8), edges = shown.flatMap(({bins}) => bins.map(([us]) => us));
  const most = Math.max(...shown.flatMap(({bins}) => bins.map(([, count]) => count)));
  const x = {low: Math.min(...edges), high: Math.max(...edges) * step, label: "duration (us)", log: true};
  const {svg, px, py} = axes(x, {low: 0, high: most * 1.05, label: "ticks"}, title);
  for (const {name, colour, bins} of shown) {
    const group = make("g", {fill: colour, "fill-opacity": 0.55, stroke: colour}, make("title", {}, name));
    for (const [us, count] of bins.filter(([, count]) => count)) {
      group.append(make("rect", {x: px(us), width: Math.max(px(us * step) - px(us), 1), y: py(count),
        height: HIGH - BOTTOM - py(count)}));
    }
    svg.append(group);
  }
  return make("div", {}, make("h3", {}, title), svg, legend(shown));
}

// The arm at `pose`, with the path of its end over `past`. `frame` is {x, y, half}, the square that is shown, mm.
function drawArm(canvas, frame, pose, past) {
  const scale = window.devicePixelRatio || 1, side = canvas.clientWidth, high = canvas.clientHeight;
  canvas.width = Math.round(side * scale);
  canvas.height = Math.round(high * scale);
  const c = canvas.getContext("2d");
  c.setTransform(scale, 0, 0, scale, 0, 0);
  const unit = Math.min(side, high) / (2 * frame.half);
  const at = ([x, y]) => [side / 2 + (x - frame.x) * unit, high / 2 - (y - frame.y) * unit];
  const trace = (points, width, colour) => {
    c.beginPath();
    points.forEach((point, i) => i ? c.lineTo(...at(point)) : c.moveTo(...at(point)));
    Object.assign(c, {lineWidth: width, strokeStyle: colour, lineCap: "round", lineJoin: "round"});
    c.stroke();
  };
  const [, points, target] = pose;
  trace(past.map(([, points]) => points[points.length - 1]), 2, css("--path"));
  trace(points, 7, css("--arm"));
  for (const joint of points) {
    c.beginPath();
    c.arc(...at(joint), 4, 0, 7);
    c.fillStyle = css("--panel");
    c.fill();
  }
  const [x, y] = at(target);
  c.beginPath();
  c.arc(x, y, 9, 0, 7);
  for (const [dx, dy] of [[14, 0], [0, 14]]) {
    c.moveTo(x - dx, y - dy);
    c.lineTo(x + dx, y + dy);
  }
  Object.assign(c, {lineWidth: 3, strokeStyle: css("--target")});
  c.stroke();
  // A bar of half a metre.
  c.fillStyle = css("--weak");
  c.fillRect(10, high - 12, 500 * unit, 2);
  c.font = "12px system-ui, sans-serif";
  c.fillText("0.5 m", 10, high - 18);
}
