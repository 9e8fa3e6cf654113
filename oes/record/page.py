"""The frame of our HTML pages: style and scripts, nothing from elsewhere."""

from html import escape

STYLE = """
[hidden] { display: none !important }
body { font: 15px/1.5 system-ui, "Segoe UI", Helvetica, Arial, sans-serif; color: #222; background: #fff;
       max-width: 1180px; margin: 2rem auto 4rem; padding: 0 1rem; font-variant-numeric: tabular-nums }
h1 { font-size: 1.5rem; font-weight: 600; margin: 0 }
h2 { font-size: 1.05rem; font-weight: 600; margin: 1.6rem 0 .4rem }
header p, .note, figcaption { color: #666; font-size: .85rem; margin: .2rem 0 .8rem }
.controls { display: flex; flex-wrap: wrap; gap: 1.6rem; align-items: center; margin: 1rem 0 .6rem; position: sticky;
            top: 0; background: #fffffff0; padding: .4rem 0; z-index: 1 }
.controls input[type=range] { width: 14rem; vertical-align: middle }
.layers { display: inline-flex; gap: 1rem }
.mosaic { position: relative; line-height: 0; border: 1px solid #ddd }
.mosaic img { width: 100%; image-rendering: auto }
.mosaic svg { position: absolute; inset: 0; width: 100%; height: 100% }
.mosaic path { fill: none; stroke-width: 1.2; stroke-opacity: .9 }
.mosaic text { font-size: 9px; fill: #fff; paint-order: stroke; stroke: #0009; stroke-width: 2px }
.charts { display: flex; flex-wrap: wrap; gap: 2rem; align-items: flex-start; margin-top: 1rem }
figure { margin: 0 }
.chart text { font-size: 11px; fill: #555 }
.chart .cursor { stroke: #222; stroke-dasharray: 2 3 }
.chart .grid { stroke: #ddd }
.plan { display: block }
.plan .table { fill: #f6f3ee; stroke: #cfc8bc; stroke-width: .002 }
.plan .hull { fill: none; stroke-width: .002; opacity: .3 }
.plan .hull.now { stroke-width: .005; opacity: 1 }
.plan .tip { fill: #111; opacity: .25 }
.plan .tip.now { opacity: 1 }
.plan .rod { fill: none; stroke: #111; stroke-width: .003 }
.plan .commanded { fill: none; stroke: #777; stroke-width: .003; stroke-dasharray: .008 .008 }
table { border-collapse: collapse; font-size: .87rem }
th { text-align: left; font-weight: 600; color: #555; border-bottom: 1px solid #bbb }
th, td { padding: .22rem .9rem .22rem 0; vertical-align: middle; white-space: nowrap }
td.number, th.number { text-align: right }
tr.now td { background: #fff6e0 }
.index th { cursor: pointer; position: sticky; top: 0; background: #fff }
.index th.up::after { content: " ▲" } .index th.down::after { content: " ▼" }
.index td { border-bottom: 1px solid #eee }
.index td.objects { white-space: normal; max-width: 22rem }
.index img { display: block }
a { color: #1f5f99; text-decoration: none } a:hover { text-decoration: underline }
"""

SHEET_SCRIPT = """
const slider = document.getElementById("step"), boxes = document.getElementById("boxes");
function show() {
  const step = slider.value, layer = document.querySelector("[name=layer]:checked").value;
  document.getElementById("now").textContent = step;
  for (const e of document.querySelectorAll("[data-step]"))
    e.toggleAttribute("hidden", e.dataset.step !== step || (e.dataset.layer ?? layer) !== layer
                                || (e.classList.contains("boxes") && !boxes.checked));
  for (const e of document.querySelectorAll("[data-mark]")) e.classList.toggle("now", e.dataset.mark === step);
}
document.addEventListener("input", show);
document.addEventListener("keydown", (e) => {
  if (e.target === slider || !["ArrowLeft", "ArrowRight"].includes(e.key)) return;
  slider.value = Number(slider.value) + (e.key === "ArrowRight" ? 1 : -1);
  show();
});
show();
"""

INDEX_SCRIPT = """
const body = document.querySelector(".index tbody"), heads = [...document.querySelectorAll(".index th")];
heads.forEach((head, column) => head.addEventListener("click", () => {
  const down = head.classList.contains("up");
  heads.forEach((e) => e.classList.remove("up", "down"));
  head.classList.add(down ? "down" : "up");
  const key = (row) => row.cells[column].dataset.value ?? row.cells[column].textContent;
  const rows = [...body.rows].sort((a, b) => key(a).localeCompare(key(b), "en", { numeric: true }));
  body.append(...(down ? rows.reverse() : rows));
}));
"""


def page(title: str, body: str, script: str) -> str:
    """A whole HTML document."""
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><title>{escape(title)}</title>'
        f"<style>{STYLE}</style></head>\n<body>{body}\n<script>{script}</script></body></html>\n"
    )
