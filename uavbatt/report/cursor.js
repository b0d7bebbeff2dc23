"use strict";
// One instant for all drawings: a line in each, and the values in words. Without this script the page is whole, too.
// No `less than` and no `and` signs here: the page is well-formed XML.
const rows = JSON.parse(document.getElementById("rows").textContent);
const panel = document.getElementById("instant"), slider = panel.querySelector("input"), said = panel.querySelector("output");
const drawings = [...document.querySelectorAll("svg[data-seconds]")].map(svg => {
  const line = document.createElementNS("http://www.w3.org/2000/svg", "line");
  const [left, right, top, bottom] = svg.dataset.box.split(" ").map(Number);
  const [first, last] = svg.dataset.seconds.split(" ").map(Number);
  line.setAttribute("class", "cursor"); line.setAttribute("y1", top); line.setAttribute("y2", bottom);
  svg.append(line);
  return { svg, line, left, right, first, last };
});
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
    const x = d.left + (time - d.first) / (d.last - d.first) * (d.right - d.left);
    d.line.setAttribute("x1", x); d.line.setAttribute("x2", x);
  }
}

function point(d, event) {
  const box = d.svg.getBoundingClientRect(), wide = d.svg.viewBox.baseVal.width;
  const x = (event.clientX - box.left) / box.width * wide;
  const time = d.first + (x - d.left) / (d.right - d.left) * (d.last - d.first);
  const after = rows.time_s.findIndex(t => t > time);
  slider.value = after === -1 ? rows.time_s.length - 1 : Math.max(after - 1, 0);
  show();
}

if (rows.time_s.length) {
  slider.max = rows.time_s.length - 1;
  const known = rows.remaining_s.findLastIndex(s => s !== null);
  slider.value = known === -1 ? slider.max : known;
  slider.addEventListener("input", show);
  for (const d of drawings) for (const kind of ["pointermove", "pointerdown"]) d.svg.addEventListener(kind, event => point(d, event));
  panel.hidden = false;
  show();
}
