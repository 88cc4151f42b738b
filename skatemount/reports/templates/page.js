"use strict";
// The page is whole without this: it only adds a cursor to charts and a filter to long lists.
for (const figure of document.querySelectorAll("figure.chart")) {
  const svg = figure.querySelector("svg");
  const data = JSON.parse(figure.querySelector("script").textContent);
  if (!data.axes) continue;
  const [left, , right] = data.axes.box;
  const [low, high] = data.axes.x;
  const width = svg.viewBox.baseVal.width;
  let shown = null;
  const short = (v) => Math.abs(v) >= 1e6 ? (v / 1e6).toFixed(2) + "M" : Math.abs(v) >= 1e4 ? (v / 1e3).toFixed(1) + "k" : String(+v.toPrecision(4));
  svg.addEventListener("pointermove", (event) => {
    const box = svg.getBoundingClientRect();
    const x = low + ((event.clientX - box.left) / box.width * width - left) / (right - left) * (high - low);
    const lines = [];
    let place = null;
    for (const line of data.lines) {
      if (line.faint) continue;
      let best = -1;
      line.x.forEach((v, i) => { if (line.y[i] !== null && (best < 0 || Math.abs(v - x) < Math.abs(line.x[best] - x))) best = i; });
      if (best < 0) continue;
      place = place === null ? line.x[best] : place;
      lines.push([line.color, (line.label ? line.label + " " : "") + short(line.y[best])]);
    }
    if (place === null) return;
    if (!shown) { shown = document.createElement("div"); shown.className = "cursor"; figure.append(shown); }
    shown.replaceChildren();
    const head = document.createElement("div");
    head.textContent = short(place);
    shown.append(head);
    for (const [color, text] of lines) {
      const row = document.createElement("div");
      row.style.color = `var(--s${color})`;
      row.textContent = text;
      shown.append(row);
    }
    const around = figure.getBoundingClientRect();
    const at = event.clientX - around.left;
    shown.style.left = (at > around.width / 2 ? at - shown.offsetWidth - 14 : at + 14) + "px";
    shown.style.top = Math.max(0, event.clientY - around.top - 20) + "px";
  });
  svg.addEventListener("pointerleave", () => { if (shown) { shown.remove(); shown = null; } });
}
for (const part of document.querySelectorAll(".filtered")) {
  const input = part.querySelector("input");
  input.addEventListener("input", () => {
    const words = input.value.toLowerCase().split(/\s+/).filter(Boolean);
    for (const row of part.querySelectorAll("[data-key]")) {
      row.hidden = !words.every((word) => row.dataset.key.toLowerCase().includes(word));
    }
  });
}
