"use strict";
document.documentElement.classList.add("js-on");
const shown = (cell) => [...cell.querySelectorAll(".v, .q")].find((part) => part.offsetParent) ?? cell;
function key(cell, column) {
  if (column === 0) return cell.textContent.trim();
  const part = shown(cell), bare = cell.closest("#matrix") ? undefined : cell.textContent.replace(/^\W+ /, "");
  const text = part.dataset.s ?? cell.dataset.v?.split("|")[0] ?? bare;
  if (text === undefined) {
    const number = cell.classList.contains("least") ? parseFloat(part.lastChild.previousSibling.textContent) : NaN;
    return part.classList?.contains("lost") ? Infinity : Number.isNaN(number) ? null : number;
  }
  return text === "" ? null : Number.isNaN(Number(text)) ? text : Number(text);
}
function sortBy(table, column, down) {
  const heads = [...table.tHead.rows[0].cells], body = table.tBodies[table.tBodies.length - 1];
  for (const head of heads) head.removeAttribute("aria-sort");
  heads[column].setAttribute("aria-sort", down ? "descending" : "ascending");
  const rows = [...body.rows];
  rows.forEach((row, place) => { row.dataset.place ??= place; });
  const keyed = rows.map((row) => [key(row.cells[column], column), row]);
  const first = (row) => Number(row.dataset.place);
  const last = (value) => (value === null ? 2 : value === Infinity ? 1 : 0);
  keyed.sort(([a, p], [b, q]) => {
    if (table.id === "matrix" && column === 0) return (first(p) - first(q)) * (down ? -1 : 1);
    if (last(a) || last(b)) return last(a) - last(b) || first(p) - first(q);
    const order = typeof a === "string" ? a.localeCompare(b) : a - b;
    return (down ? -order : order) || first(p) - first(q);
  });
  body.append(...keyed.map(([, row]) => row));
  if (table.id === "matrix") {
    document.getElementById("sorted").textContent = `sorted by ${heads[column].innerText.trim()}${down ? ", largest first" : ""}`;
    document.getElementById("sort").value = column ? String(column) : "";
  }
}
for (const table of document.querySelectorAll("#matrix, table.sortable"))
  [...table.tHead.rows[0].cells].forEach((head, column) => head.querySelector("button").addEventListener("click", () =>
    sortBy(table, column, head.getAttribute("aria-sort") === "ascending")));
const matrix = document.getElementById("matrix");
document.getElementById("sort")?.addEventListener("change", (event) => sortBy(matrix, Number(event.target.value), false));
matrix?.addEventListener("keydown", (event) => {
  const step = { ArrowRight: [1, 0], ArrowLeft: [-1, 0], ArrowDown: [0, 1], ArrowUp: [0, -1] }[event.key];
  if (!step || !event.target.matches("a")) return;
  event.preventDefault();
  const rows = [...matrix.tBodies[1].rows], cell = event.target.closest("th, td");
  let x = cell.cellIndex, y = rows.indexOf(cell.parentElement);
  for (;;) {
    x += step[0]; y += step[1];
    const target = rows[y]?.cells[x];
    if (!target) return;
    const link = [...target.querySelectorAll("a")].find((part) => part.offsetParent);
    if (link) { link.focus(); return; }
  }
});
const quoted = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
function saved(name, text, type) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type }));
  link.download = name.replaceAll(/[^\w.-]+/g, "-");
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
function tableCsv(table) {
  const heads = [...table.tHead.rows[0].cells].map((head) => head.dataset.c.split("|"));
  const lines = [heads.flat(), ...[...table.tBodies[table.tBodies.length - 1].rows].map((row) => [...row.cells].flatMap((cell, i) => {
    const count = heads[i].length, part = shown(cell);
    if (cell.classList.contains("least")) return [part.childNodes[1].textContent, part.lastChild.textContent];
    const text = cell.dataset.v ?? (part === cell ? cell.textContent.replace(/^\W+ /, "") : part.innerText.replaceAll("\n", " ")).trim();
    const found = count > 1 ? text.split("|") : [text];
    return Array.from({ length: count }, (_, place) => found[place] ?? "");
  }))];
  return lines.map((line) => line.map(quoted).join(",")).join("\n") + "\n";
}
function curvesCsv(panels) {
  const { x0, x1, y0, y1, log } = panels.dataset, lines = ["entry,time_s,rms_error"];
  for (const svg of panels.querySelectorAll("svg")) {
    const path = (svg.querySelector(".o")).getAttribute("d").replace(/^M/, "").replace("l", " ");
    const steps = path.replaceAll("-", " -").trim().split(/\s+/).map(Number);
    let x = 0, y = 0;
    for (let i = 0; i < steps.length; i += 2) {
      x += steps[i]; y += steps[i + 1];
      const share = 1 - y / 66, time = Number(x0) + x / 150 * (x1 - x0);
      const value = log === "1" ? Number(y0) * (y1 / y0) ** share : Number(y0) + share * (y1 - y0);
      lines.push([svg.getAttribute("aria-label"), time.toPrecision(5), value.toPrecision(3)].join(","));
    }
  }
  return lines.join("\n") + "\n";
}
function figureSvg(figure) {
  const space = "http://www.w3.org/2000/svg", out = document.createElementNS(space, "svg");
  let x = 0, height = 0;
  for (const part of figure.querySelectorAll("svg")) {
    const copy = part.cloneNode(true);
    copy.setAttribute("x", x);
    copy.setAttribute("width", part.viewBox.baseVal.width); copy.setAttribute("height", part.viewBox.baseVal.height);
    x += part.viewBox.baseVal.width + 8; height = Math.max(height, part.viewBox.baseVal.height);
    out.append(copy);
  }
  out.setAttribute("xmlns", space); out.setAttribute("class", "ranked");
  out.setAttribute("viewBox", `0 0 ${x} ${height}`); out.setAttribute("font-family", "sans-serif");
  const style = document.createElementNS(space, "style");
  style.textContent = document.getElementById("style").textContent.replaceAll("@media screen and (prefers-color-scheme: dark)", "@media not all");
  out.prepend(style);
  return new XMLSerializer().serializeToString(out);
}
document.addEventListener("click", (event) => {
  const button = event.target.closest?.("button.save");
  if (!button) return;
  if (button.dataset.save === "table") {
    const before = [...document.querySelectorAll("#matrix, table.sortable")].filter((t) => t.compareDocumentPosition(button) & 4).pop();
    saved(`${before.dataset.name}.csv`, tableCsv(before), "text/csv");
  } else if (button.dataset.save === "svg") {
    const figure = button.closest("figure");
    saved(`${figure.closest("section").id}.svg`, figureSvg(figure), "image/svg+xml");
  } else {
    const figure = button.closest("figure");
    saved(`${figure.dataset.name}.csv`, curvesCsv(figure.querySelector(".panels")), "text/csv");
  }
});
addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((part) => { part.open = true; }));
