"use strict";
// Tables sort by a click on a heading: by value, what has none last, equal rows in the order they had.
for (const table of document.querySelectorAll("table")) {
  const body = table.tBodies[0];
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => head.querySelector("button").addEventListener("click", () => {
    const first = head.classList.contains("n") ? "descending" : "ascending";
    const other = first === "descending" ? "ascending" : "descending";
    const order = head.getAttribute("aria-sort") === first ? other : first;
    heads.forEach(each => each.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", order);
    const sign = order === "ascending" ? 1 : -1;
    const key = row => row.cells[column].dataset.v;
    const before = (one, two) => head.classList.contains("n")
      ? Number(one) - Number(two) : one.localeCompare(two, "en", { numeric: true });
    const rows = [...body.rows].sort((one, two) => {
      const a = key(one), b = key(two);
      if (a === undefined || b === undefined) return (a === undefined) - (b === undefined);
      return sign * before(a, b);
    });
    body.append(...rows);
  }));
}

// What is recommended is in view.
for (const row of document.querySelectorAll(".tall tr.chosen")) {
  const box = row.closest(".box");
  box.scrollTop = row.offsetTop - box.clientHeight / 2;
}

// Plots show what they hold where the pointer is near, and to the arrow keys: one stop of the tab key a plot.
const hint = document.getElementById("hint");
let shown = null;

function hide() {
  if (shown) shown.classList.remove("at");
  shown = null;
  hint.hidden = true;
}

function show(point) {
  if (shown !== point) hide();
  shown = point;
  point.classList.add("at");
  hint.textContent = point.getAttribute("aria-label");
  hint.hidden = false;
  const mark = point.querySelector(".mark").getBoundingClientRect();
  const page = document.documentElement;
  const middle = (mark.left + mark.right) / 2;
  const left = Math.max(8, Math.min(middle - hint.offsetWidth / 2, page.clientWidth - hint.offsetWidth - 8));
  const above = mark.top - hint.offsetHeight - 10;
  hint.style.left = `${left + window.scrollX}px`;
  hint.style.top = `${(above > 8 ? above : mark.bottom + 10) + window.scrollY}px`;
}

for (const plot of document.querySelectorAll("svg.plot")) {
  const points = [...plot.querySelectorAll(".pt")].sort((one, two) =>
    plot.dataset.down ? one.dataset.y - two.dataset.y
      : one.dataset.x - two.dataset.x || one.dataset.y - two.dataset.y);
  if (!points.length) continue;
  let at = 0;
  const go = next => {
    points[at].tabIndex = -1;
    at = (next + points.length) % points.length;
    points[at].tabIndex = 0;
    points[at].focus({ preventScroll: false });
  };
  points[0].tabIndex = 0;
  points.forEach((point, k) => {
    point.addEventListener("focus", () => { points[at].tabIndex = -1; at = k; point.tabIndex = 0; show(point); });
    point.addEventListener("blur", hide);
  });
  plot.addEventListener("keydown", event => {
    const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    if (step) go(at + step);
    else if (event.key === "Home") go(0);
    else if (event.key === "End") go(points.length - 1);
    else if (event.key === "Escape") return hide();
    else return;
    event.preventDefault();
  });
  plot.addEventListener("pointermove", event => {
    const frame = plot.getBoundingClientRect();
    const scale = plot.viewBox.baseVal.width / frame.width;
    const x = (event.clientX - frame.left) * scale, y = (event.clientY - frame.top) * scale;
    const far = point => Math.hypot(point.dataset.x - x, point.dataset.y - y);
    const near = points.reduce((best, point) => far(point) < far(best) ? point : best);
    if (far(near) < 28) show(near); else if (document.activeElement !== shown) hide();
  });
  plot.addEventListener("pointerleave", () => { if (document.activeElement !== shown) hide(); });
}
document.addEventListener("keydown", event => { if (event.key === "Escape") hide(); });

for (const button of document.querySelectorAll(".copy")) {
  if (!navigator.clipboard) { button.hidden = true; continue; }
  button.addEventListener("click", () => navigator.clipboard.writeText(button.previousElementSibling.textContent)
    .then(() => { button.textContent = "Copied"; }, () => { button.textContent = "Not allowed"; }));
}
