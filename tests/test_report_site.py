"""The page of results: whole in one file, and shown by a real browser without a fault."""

import json
import re
import shutil
import subprocess
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from oes.report.aggregates import tidy
from oes.report.figures import Media
from oes.report.pages import fill_pages
from oes.report.site import Fact, write_site
from oes.report.table import Table, TableGroup
from oes.viz.video import write_video

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")
# Waits for every picture and film, then sends what it found to where the page came from.
PROBE = """<script>
window.faults = [];
addEventListener("error", (e) => window.faults.push(String(e.message ?? e.target.tagName)), true);
addEventListener("load", async () => {
  const all = (name) => [...document.querySelectorAll(name)];
  const films = all("video"), images = all("img");
  images.forEach((e) => { e.loading = "eager"; });
  await Promise.all(images.map((e) => e.decode()));
  await Promise.all(films.map((e) => e.readyState >= 2 || new Promise((done) => {
    e.preload = "auto"; e.addEventListener("loadeddata", done); e.load();
  })));
  fetch("/found", { method: "POST", body: JSON.stringify({
    images: images.every((e) => e.naturalWidth > 0), films: films.map((e) => e.videoWidth),
    wide: Math.max(0, document.documentElement.scrollWidth - innerWidth),
    nested: all(".table").filter((e) => e.scrollHeight > e.clientHeight + 20).length,
    wrapped: all("td").filter((e) => e.clientHeight > 40).length,
    faults: window.faults }) });
});
</script>"""


@pytest.fixture
def page(tmp_path: Path) -> Path:
    """A page with one table, one picture and one film."""
    (tmp_path / "figures").mkdir()
    noise = np.random.default_rng(0).integers(0, 255, (6, 48, 64, 3)).astype(np.uint8)
    Image.fromarray(noise[0]).save(tmp_path / "figures/error-over-time.png")
    write_video(noise, tmp_path / "figures/rollouts-pushing.mp4", 5)
    cells = [(f"model {i}", *(f"{i}.{j} [0.0, 99.9]" for j in range(12))) for i in range(3)]
    cells.append(("3D-OES", *(["1.0"] * 12)))
    table = Table("A wide table", ("model", *map(str, range(12))), tuple(cells))
    group = TableGroup("table1", "Errors", (table,), tidy([]), ("A note <of> it.",))
    media = [
        Media("pushing", "figures/error-over-time.png", "Errors."),
        Media("pushing", "figures/rollouts-pushing.mp4", "Two forecasts."),
    ]
    pages = fill_pages({"table1": group}, media)
    facts = [Fact("0.5", "a ratio")]
    write_site(tmp_path / "index.html", ["Where it is from."], facts, table, pages)
    return tmp_path / "index.html"


def test_the_page_holds_everything_and_asks_for_nothing(page: Path) -> None:
    text = page.read_text()
    assert set(re.findall(r'(?:src|href)="([^",]*)', text)) == {
        "#pushing", "data:image/png;base64", "data:video/mp4;base64",
    }  # fmt: skip
    assert '<tr class="ours"><td>3D-OES</td><td>1.0</td>' in text
    assert "A note &lt;of&gt; it." in text and "<figcaption>Two forecasts.</figcaption>" in text
    assert "Falling" not in text, "no section without anything in it"
    assert "not a purely learned simulator" in text


class Served(HTTPServer):
    """Serves one page to a browser and keeps what the probe in it sends back."""

    def __init__(self, page: str) -> None:
        super().__init__(("127.0.0.1", 0), Answer)
        self.page, self.found, self.reported = page.encode(), {}, threading.Event()


class Answer(BaseHTTPRequestHandler):
    """The page for whatever is asked; what is posted is kept."""

    server: Served

    def do_GET(self) -> None:
        self.send_response(200 if self.path == "/" else 204)
        self.end_headers()
        self.wfile.write(self.server.page if self.path == "/" else b"")

    def do_POST(self) -> None:
        self.server.found = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.send_response(204)
        self.end_headers()
        self.server.reported.set()

    def log_message(self, format: str, *args: object) -> None:
        """Quiet."""


@pytest.mark.skipif(BROWSER is None, reason="no Chromium here")
@pytest.mark.parametrize("width_px", [1280, 390])
def test_a_browser_shows_it_without_a_fault(page: Path, tmp_path: Path, width_px: int) -> None:
    served = Served(page.read_text().replace("<head>", "<head>" + PROBE))
    threading.Thread(target=served.serve_forever, daemon=True).start()
    command = [str(BROWSER), "--headless", "--no-sandbox", "--disable-gpu",
               f"--window-size={width_px},800", f"--user-data-dir={tmp_path / 'profile'}",
               "--remote-debugging-port=0",
               f"http://127.0.0.1:{served.server_port}/"]  # fmt: skip
    browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        assert served.reported.wait(120), "the browser never reported"
    finally:
        browser.terminate()
        browser.wait(30)
        served.shutdown()
        served.server_close()
    assert served.found == {
        "images": True, "films": [64], "wide": 0, "nested": 0, "wrapped": 0, "faults": [],
    }  # fmt: skip
