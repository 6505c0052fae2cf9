"""The page in a real browser: it loads without errors, and its slider moves paths to where the engine says.

A browser is used where there is one; the numbers that it draws are tested without it in `test_page.py`.
"""

import json
import re
import shutil
import subprocess
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from tests.report.model_view.conftest import FRAMES, MUSCLES

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")

#: Uses the page's own controls as a person would, and writes what it finds into the document.
DRIVER = """
<script>
(function () {
  const found = { errors: [], frames: [] };
  window.addEventListener("error", (event) => found.errors.push(event.message));
  window.addEventListener("unhandledrejection", (event) => found.errors.push(String(event.reason)));
  // The browser runs in virtual time, in which a loaded machine draws hardly a frame.
  window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 16);
  const byId = (id) => document.getElementById(id);
  const set = (id, value, event = "change") => {
    byId(id).value = value;
    byId(id).dispatchEvent(new Event(event, { bubbles: true }));
  };
  const press = (kind, x, y) => byId("canvas").dispatchEvent(
    new PointerEvent(kind, { clientX: x, clientY: y, bubbles: true, pointerId: 1 }));
  const inked = () => {
    const picture = document.createElement("canvas");
    picture.width = picture.height = 64;
    const context = picture.getContext("2d");
    window.wrapjaxView.draw();
    context.drawImage(byId("canvas"), 0, 0, 64, 64);
    const pixels = context.getImageData(0, 0, 64, 64).data;
    let count = 0;
    for (let at = 0; at < pixels.length; at += 4) if (pixels[at] !== 247 || pixels[at + 1] !== 248) count++;
    return count;
  };
  function drive() {
    const view = window.wrapjaxView;
    if (!view) return setTimeout(drive, 20);
    found.problem = byId("problem").hidden;
    found.begin = { ...view.state, visible: null };
    found.inked = inked();
    set("view", "side");
    for (const [motion, frame] of MOMENTS) {
      set("motion", motion);
      set("frame", frame, "input");
      const cursor = document.querySelector("[data-cursor=moment_arm]");
      found.frames.push({
        psoas: [view.drawn("psoas_l", 0), view.drawn("psoas_l", 1)],
        tibant: view.drawn("tibant_l", 1),
        progress: byId("progress").textContent,
        cursor: Number(cursor.getAttribute("x1")),
        readings: [...cursor.closest("figure").querySelectorAll(".key b")].map((one) => one.textContent),
      });
    }
    set("view", "overlaid");
    found.overlaid = [view.drawn("psoas_l", 0).length, view.drawn("gasmed_l", 0).length];
    found.colors = {};
    for (const name of ["", "moment_arm", "gap"]) {
      set("coloring", name);
      set("coordinate", 3);
      found.colors[name] = {
        swatches: [...document.querySelectorAll("#muscles .swatch")].map((one) => one.style.backgroundColor),
        legend: byId("legend").hidden ? "" : byId("legend-title").textContent,
      };
    }
    // The pointer finds a muscle, and a click selects it.
    byId("only").click();
    found.alone = [view.drawn("psoas_l", 1).length, view.drawn("gasmed_l", 1).length];
    byId("all").click();
    const box = byId("canvas").getBoundingClientRect();
    search: for (let row = 2; row < 48; row++) for (let column = 2; column < 48; column++) {
      const at = [box.left + box.width * column / 50, box.top + box.height * row / 50];
      press("pointermove", ...at);
      const name = byId("tip").hidden ? "" : byId("tip").textContent.split(":")[0];
      if (name === "tibant_l") {
        press("pointerdown", ...at);
        press("pointerup", ...at);
        found.picked = view.state.muscle;
        break search;
      }
    }
    set("frame", 0, "input");
    set("speed", "1");
    byId("play").click();
    let tries = 0;
    (function played() {
      if (view.state.frame === 0 && tries++ < 400) return setTimeout(played, 25);
      found.played = view.state.frame;
      byId("play").click();
      found.playing = view.state.playing;
      found.requests = performance.getEntriesByType("resource").map((one) => one.name);
      const result = document.createElement("pre");
      result.id = "found";
      result.textContent = "FOUND" + JSON.stringify(found) + "END";
      document.body.append(result);
    })();
  }
  drive();
})();
</script>
"""
MOMENTS = ((0, 0), (0, 5), (1, 3))


@dataclass(frozen=True)
class Visit:
    """What the driver found, and what the browser printed to its console."""

    found: dict[str, Any]
    console: list[str] = field(default_factory=list)


@pytest.fixture(scope="module")
def visit(page, tmp_path_factory):
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip("there is no Chromium or Chrome; the page's numbers are tested in test_page.py")
    folder = tmp_path_factory.mktemp("browser")
    driver = DRIVER.replace("MOMENTS", json.dumps(MOMENTS))
    (folder / "page.html").write_text(page.replace("</body>", f"{driver}</body>"), encoding="utf-8")
    options = (
        *("--headless=new", "--no-sandbox", "--disable-extensions", "--no-first-run"),
        # Drawing by software, as where there is no graphics card; no name is looked up.
        *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--host-resolver-rules=MAP * ~NOTFOUND"),
        *("--window-size=1200,900", "--virtual-time-budget=20000", "--enable-logging=stderr", "--dump-dom"),
        f"--user-data-dir={folder / 'profile'}",
    )
    done = subprocess.run(
        [browser, *options, (folder / "page.html").as_uri()], capture_output=True, text=True, timeout=180
    )
    written = re.search(r"FOUND(.*?)END", done.stdout.partition('<pre id="found">')[2], flags=re.S)
    assert written, done.stderr[-3000:]
    text = written[1].replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&")
    return Visit(json.loads(text), [line for line in done.stderr.splitlines() if ":CONSOLE" in line])


def test_page_loads_without_errors_and_asks_for_nothing(visit):
    assert visit.found["errors"] == [] and visit.console == []
    assert visit.found["requests"] == []
    assert visit.found["problem"] is True  # the message of a browser that cannot draw is hidden
    assert visit.found["inked"] > 50


def test_slider_moves_the_paths_to_where_the_engine_says(visit, scene):
    """As drawn: ends of the rods on the screen, less than half a step of storage (0.05 mm) off in x, y, z."""
    for (motion, frame), drawn in zip(MOMENTS, visit.found["frames"], strict=True):
        number = motion * FRAMES + frame
        for placement in (0, 1):
            expected = scene.paths["psoas_l"][placement].frame(number)
            np.testing.assert_allclose(drawn["psoas"][placement], expected, atol=3e-5)
        np.testing.assert_allclose(drawn["tibant"], scene.paths["tibant_l"][0].frame(number), atol=3e-5)
    before, after = (visit.found["frames"][place]["tibant"][-1] for place in (0, 1))
    assert np.linalg.norm(np.subtract(before, after)) > 0.01


def test_curves_follow_the_slider(visit, scene):
    """At first, the page shows the moment arm that calibration changed most."""
    before, after = (path.moment_arm for path in scene.paths["psoas_l"])
    coordinate = int(np.abs(after - before).mean(axis=1).argmax())
    begin = visit.found["begin"]
    assert (MUSCLES[begin["muscle"]], begin["coordinate"]) == ("psoas_l", coordinate)
    for (motion, frame), drawn in zip(MOMENTS, visit.found["frames"], strict=True):
        percent = 100.0 * frame / (FRAMES - 1)
        assert drawn["progress"].startswith(f"{percent:.1f}".removesuffix(".0") + " % of the gait cycle")
        assert drawn["cursor"] == pytest.approx(40 + (360 - 40 - 14) * percent / 100.0, abs=0.01)
        for reading, path in zip(drawn["readings"], scene.paths["psoas_l"], strict=True):
            expected = 1e3 * path.moment_arm[coordinate, motion * FRAMES + frame]
            assert float(reading.replace("\N{MINUS SIGN}", "-")) == pytest.approx(expected, abs=0.051)


def test_overlaid_view_draws_twice_only_what_moved(visit):
    assert visit.found["overlaid"][0] > 0 and visit.found["overlaid"][1] == 0
    assert visit.found["alone"][0] > 0 and visit.found["alone"][1] == 0


def test_muscles_take_colors(visit):
    """The ankle is spanned by gasmed and tibant, whose moment arms have opposite signs, and not by psoas."""
    plain, arm, gap = (visit.found["colors"][name] for name in ("", "moment_arm", "gap"))
    assert plain["legend"] == "" and len(set(plain["swatches"])) == 1
    assert arm["legend"] == "Moment arm about ankle_angle_l (mm)" and len(set(arm["swatches"])) == 3
    assert gap["legend"] == "Explainable error about ankle_angle_l (N m)"


def test_click_selects_a_muscle_and_play_moves_time(visit):
    assert MUSCLES[visit.found["picked"]] == "tibant_l"
    assert 0 < visit.found["played"] < FRAMES and visit.found["playing"] is False
