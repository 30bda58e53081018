"use strict";
// What is drawn: the arm on a canvas, curves and bars with uPlot. Each function draws what it is given.

const css = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const short = x => x == null ? "-" : Math.abs(x) >= 1e5 || (x && Math.abs(x) < 1e-3) ? x.toExponential(1)
  : String(Number(x.toPrecision(3)));
const thousands = n => n.toLocaleString("en");
const seconds = s => s == null ? "?" : s < 60 ? `${Math.round(s)} s` : s < 3600
  ? `${Math.floor(s / 60)}:${String(Math.floor(s % 60)).padStart(2, "0")} min`
  : `${Math.floor(s / 3600)}:${String(Math.floor(s % 3600 / 60)).padStart(2, "0")} h`;
const micros = us => us == null ? "-" : us < 999.5 ? `${short(us)} us` : us < 999500 ? `${short(us / 1000)} ms`
  : `${short(us / 1e6)} s`;

// The arm at `record`, with the path of its end over `past` (oldest first). `frame` is the square that is shown.
function drawArm(canvas, frame, record, past) {
  const scale = window.devicePixelRatio || 1, side = canvas.clientWidth, high = canvas.clientHeight;
  if (canvas.width !== Math.round(side * scale) || canvas.height !== Math.round(high * scale)) {
    canvas.width = Math.round(side * scale);
    canvas.height = Math.round(high * scale);
  }
  const c = canvas.getContext("2d");
  c.setTransform(scale, 0, 0, scale, 0, 0);
  c.clearRect(0, 0, side, high);
  const metre = Math.min(side, high) / (2 * frame.half);
  const at = ([x, y]) => [side / 2 + (x - frame.centre[0]) * metre, high / 2 - (y - frame.centre[1]) * metre];
  const trace = (points, width, colour) => {
    c.beginPath();
    points.forEach((point, i) => i ? c.lineTo(...at(point)) : c.moveTo(...at(point)));
    c.lineWidth = width;
    c.strokeStyle = colour;
    c.lineCap = c.lineJoin = "round";
    c.stroke();
  };
  const ends = past.filter(r => r.p.length).map(r => r.p[r.p.length - 1]);
  if (ends.length > 1) trace(ends, 2, css("--path"));
  trace(record.p, 7, css("--arm"));
  for (const joint of record.p) {
    c.beginPath();
    c.arc(...at(joint), 4, 0, 7);
    c.fillStyle = css("--panel");
    c.fill();
    c.lineWidth = 2;
    c.strokeStyle = css("--arm");
    c.stroke();
  }
  if (record.g) {
    const [x, y] = at(record.g);
    c.strokeStyle = css("--target");
    c.lineWidth = 3;
    c.beginPath();
    c.arc(x, y, 9, 0, 7);
    c.moveTo(x - 14, y);
    c.lineTo(x + 14, y);
    c.moveTo(x, y - 14);
    c.lineTo(x, y + 14);
    c.stroke();
  }
  // A bar of half a metre.
  c.fillStyle = css("--weak");
  c.fillRect(10, high - 12, metre / 2, 2);
  c.fillText("0.5 m", 10, high - 16);
}

// Inputs and applied commands as bars, where there is no arm to draw.
function drawBars(element, signals, values) {
  if (element.childElementCount !== signals.length) {
    element.replaceChildren(...signals.map(s => {
      const row = document.createElement("div");
      row.className = "bar";
      const name = document.createElement("span"), meter = document.createElement("meter");
      name.textContent = s.name;
      [meter.min, meter.max] = [s.min, s.max];
      row.append(name, meter, document.createElement("span"));
      return row;
    }));
  }
  signals.forEach((s, i) => {
    const [, meter, text] = element.children[i].children;
    meter.value = values[i] ?? s.min;
    text.textContent = `${short(values[i])} ${s.unit}`;
  });
}

// A curve over the run's time, with vertical marks. It is made anew only where size, scale or theme changes.
class CurvePlot {
  constructor(element, colour, options = {}) {
    Object.assign(this, {element, colour, options, marks: [], plot: null, key: ""});
  }

  show(data, marks) {
    this.marks = marks;
    const values = data.slice(1).flat().filter(y => y != null);
    const log = !this.options.linear && values.length > 1 && Math.min(...values) > 0
      && Math.max(...values) / Math.min(...values) > 30;
    const width = this.element.clientWidth, key = [width, log, css("--ink")].join();
    if (key !== this.key || !this.plot) {
      this.key = key;
      this.plot?.destroy();
      this.plot = new uPlot(this.settings(width, log), data, this.element);
    } else {
      this.plot.setData(data);
    }
  }

  settings(width, log) {
    const axis = {stroke: css("--weak"), grid: {stroke: css("--line"), width: 1}, ticks: {stroke: css("--line")}};
    const y = {...axis, size: 56, values: (u, all) => all.map(v => v == null ? "" : short(v))};
    const line = (name, i) => ({label: name, stroke: css(this.colour[i]), width: 1.5, points: {show: false},
      value: (u, v) => short(v), ...this.options.series});
    const x = this.options.x ?? {label: "time", value: (u, v) => v == null ? "" : seconds(v)};
    return {
      width, height: 170, cursor: {drag: {x: true, y: false}}, legend: {live: true},
      scales: {x: {time: false, ...this.options.scale}, y: {distr: log ? 3 : 1}},
      axes: [{...axis, values: this.options.ticks ?? ((u, all) => all.map(seconds))}, y],
      series: [x, ...this.options.names.map(line)],
      hooks: {draw: [u => this.drawMarks(u)]},
    };
  }

  drawMarks(u) {
    const c = u.ctx, {left, top, width, height} = u.bbox;
    c.save();
    c.lineWidth = 1;
    for (const mark of this.marks) {
      const x = u.valToPos(mark.at, "x", true);
      if (x < left || x > left + width) continue;
      c.strokeStyle = c.fillStyle = css(mark.kind === "restart" ? "--bad" : "--target");
      c.setLineDash(mark.kind === "restart" ? [2, 3] : [6, 4]);
      c.beginPath();
      c.moveTo(x, top);
      c.lineTo(x, top + height);
      c.stroke();
    }
    c.restore();
  }
}
