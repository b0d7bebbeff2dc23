"use strict";
// One instant for all drawings: a line in each, and the values in words; and one span of time that all of them show.
// Without this script the page is whole, too.
// No `less than` and no `and` signs here: the page is well-formed XML.
const rows = JSON.parse(document.getElementById("rows").textContent);
const panel = document.getElementById("instant"), slider = panel.querySelector("input"), said = panel.querySelector("output");
const drawings = [...document.querySelectorAll("svg[data-seconds]")].map(svg => {
  const line = document.createElementNS("http://www.w3.org/2000/svg", "line");
  const [left, right, top, bottom] = svg.dataset.box.split(" ").map(Number);
  const [first, last] = svg.dataset.seconds.split(" ").map(Number);
  line.setAttribute("class", "cursor"); line.setAttribute("y1", top); line.setAttribute("y2", bottom);
  svg.append(line);
  const ticks = [...svg.querySelectorAll(".ticks > g")].filter(g => g.querySelector("use"));
  return { svg, line, left, right, first, last, ticks, seconds: svg.dataset.unit === "1", made: [] };
});
const STEPS = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1200], MOST_TICKS = 8, CLOSEST_S = 10, DRAGGED = 8;
const whole = drawings.length ? [drawings[0].first, drawings[0].last] : [0, 1];
let view = whole;

const scale = d => (d.last - d.first) / (view[1] - view[0]);
const unmoved = (d, time) => d.left + (time - d.first) / (d.last - d.first) * (d.right - d.left);
const place = (d, time) => d.left + (time - view[0]) / (view[1] - view[0]) * (d.right - d.left);
const clock = s => s === null ? "not known" : (s >= 0 ? "" : "\u2212") + Math.floor(Math.abs(s) / 60) + ":" + String(Math.floor(Math.abs(s) % 60)).padStart(2, "0");
const value = (x, digits, unit) => x === null ? "" : " \u00b7 " + x.toFixed(digits) + "\u202f" + unit;

function words(k) {
  const left = rows.remaining_s[k];
  const time = left === null ? "no forecast" : clock(left) + " left (" + clock(rows.lo_s[k]) + " to " + clock(rows.hi_s[k]) + ")";
  return "At " + clock(rows.time_s[k]) + ": " + time + value(rows.charge[k], 0, "% charge") + value(rows.voltage_V[k], 2, "V")
    + value(rows.current_A[k], 1, "A") + value(rows.temp_C[k], 0, "\u00b0C");
}

function show() {
  const k = Number(slider.value), time = rows.time_s[k];
  said.textContent = words(k);
  slider.setAttribute("aria-valuetext", said.textContent);
  for (const d of drawings) {
    const x = place(d, time);
    d.line.setAttribute("x1", x); d.line.setAttribute("x2", x);
    d.line.toggleAttribute("hidden", view[0] > time || time > view[1]);
  }
}

function at(d, event) {
  const box = d.svg.getBoundingClientRect(), wide = d.svg.viewBox.baseVal.width;
  const x = (event.clientX - box.left) / box.width * wide;
  return view[0] + (x - d.left) / (d.right - d.left) * (view[1] - view[0]);
}

function point(d, event) {
  const time = at(d, event);
  const after = rows.time_s.findIndex(t => t > time);
  slider.value = after === -1 ? rows.time_s.length - 1 : Math.max(after - 1, 0);
  show();
}

// Where a text stands: by its attributes, for a drawing that is not shown has no box.
function anchor(g) {
  const text = g.querySelector("text"), shifted = /translate\(([-.0-9]+)/.exec(text.getAttribute("transform") || "");
  return Number(shifted === null ? text.getAttribute("x") : shifted[1]);
}

// What is drawn of the flight is stretched inside its frame; words keep their letters, and the axis gets ticks of its own.
function stretch(d) {
  const k = scale(d), shift = d.left - k * unmoved(d, view[0]);
  for (const g of d.svg.querySelectorAll(".moves")) {
    const inside = g.querySelector("[clip-path]");
    if (inside !== null) if (!g.parentNode.classList.contains("frame")) {
      const frame = document.createElementNS("http://www.w3.org/2000/svg", "g");
      frame.setAttribute("class", "frame"); frame.setAttribute("clip-path", inside.getAttribute("clip-path"));
      g.replaceWith(frame); frame.append(g);
    }
    g.setAttribute("transform", "matrix(" + k + " 0 0 1 " + shift + " 0)");
  }
  for (const g of d.svg.querySelectorAll(".words")) {
    const x = anchor(g), moved = k * x + shift;
    g.setAttribute("transform", "translate(" + (moved - x) + " 0)");
    g.toggleAttribute("hidden", d.left - 20 > moved || moved > d.right);
  }
  ticked(d);
}

function ticked(d) {
  for (const g of d.made) g.remove();
  const isWhole = view === whole, span = view[1] - view[0];
  for (const g of d.ticks) g.toggleAttribute("hidden", !isWhole);
  d.made = [];
  if (isWhole || d.ticks.length === 0) return;
  const step = STEPS.find(s => MOST_TICKS > span / s) || 3600, model = d.ticks[0], from = anchor(model);
  for (let time = Math.ceil(view[0] / step) * step; view[1] >= time; time += step) {
    const g = model.cloneNode(true);
    g.removeAttribute("hidden");
    g.setAttribute("transform", "translate(" + (place(d, time) - from) + " 0)");
    g.querySelector("text").textContent = d.seconds ? String(time) : clock(time);
    model.parentNode.append(g); d.made.push(g);
  }
}

function see(begin, end) {
  const span = Math.min(Math.max(end - begin, CLOSEST_S), whole[1] - whole[0]);
  const first = Math.min(Math.max((begin + end - span) / 2, whole[0]), whole[1] - span);
  view = span === whole[1] - whole[0] ? whole : [first, first + span];
  drawings.forEach(stretch);
  show();
}

function closer(factor) {
  const time = rows.time_s[Number(slider.value)], half = (view[1] - view[0]) * factor / 2;
  if (factor === 0) see(...whole); else see(time - half, time + half);
}

function draggable(d) {
  let begin = null;
  d.svg.addEventListener("pointerdown", event => { if (event.pointerType === "mouse") begin = event; });
  d.svg.addEventListener("pointerup", event => {
    if (begin !== null) if (Math.abs(event.clientX - begin.clientX) > DRAGGED) {
      const ends = [at(d, begin), at(d, event)].sort((a, b) => a - b);
      see(Math.max(ends[0], whole[0]), Math.min(ends[1], whole[1]));
    }
    begin = null;
  });
  d.svg.addEventListener("dblclick", () => see(...whole));
}

if (rows.time_s.length) {
  slider.max = rows.time_s.length - 1;
  const known = rows.remaining_s.findLastIndex(s => s !== null);
  slider.value = known === -1 ? slider.max : known;
  slider.addEventListener("input", show);
  const keys = { "+": 0.5, "=": 0.5, "-": 2, "0": 0 };
  slider.addEventListener("keydown", event => { if (event.key in keys) closer(keys[event.key]); });
  for (const button of panel.querySelectorAll("button")) button.addEventListener("click", () => closer(Number(button.value)));
  drawings.forEach(draggable);
  for (const d of drawings) for (const kind of ["pointermove", "pointerdown"]) d.svg.addEventListener(kind, event => point(d, event));
  panel.hidden = false;
  show();
}
