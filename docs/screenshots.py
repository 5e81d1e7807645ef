"""Make the pictures of the docs: of a report and its player, and what the cameras show.

``python docs/screenshots.py`` runs the built-in scenarios with a component that never gives way,
and needs Debian's Chromium and Playwright; ``--bundle DIR`` takes evidence that is there already.
``--cameras`` makes the pictures of the two cameras alone, and needs none of these.
"""  # noqa: INP001 - a script, no package

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
EVIDENCE = "dura-evidence"
FLAGS = (
    "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-quic",
    "--disable-component-update", "--disable-sync", "--no-first-run",
)  # fmt: skip
WIDE = {"width": 1280, "height": 1360}
NARROW = {"width": 390, "height": 844}
LARGEST = 300_000
"""Bytes of a picture; the README loads all of them."""


CAMERA_WORLD = {
    "ego": {"distance": 23.0, "speed": 4.0},
    "vehicles": [
        {"id": "W", "arm": "west", "distance": 3.5, "speed": 7.0},
        {"id": "N", "arm": "north", "distance": 14.0, "speed": 3.0},
        {"id": "E", "arm": "east", "distance": 28.0, "speed": 7.0},
    ],
    "pedestrians": [{"id": "P1", "offset": 4.0, "start": 0.0, "speed": 3.0}],
    "obstacles": [
        {"id": "PARKED", "kind": "parked_car", "offset": 10.0, "beside": 5.4},
        {"id": "CONES", "kind": "cones", "offset": 4.0, "beside": -5.0},
    ],
    "controls": {
        "signals": [{"arms": ["south", "north"], "phases": [{"state": "red", "lasts": 60.0}]}]
    },
}
"""What the cameras' pictures show: who can be there, all at once."""
ENLARGED = {"camera_front": 4, "camera_third_person": 2}
"""How many times as large, along each side, a camera's picture is in the docs."""


def take_cameras(folder: Path) -> None:
    """The pictures of both cameras at one tick, each pixel enlarged."""
    from PIL import Image

    from pytest_dura.driving.highway import HighwaySimulator
    from pytest_dura.driving.maneuvers import Command

    simulator = HighwaySimulator()
    simulator.reset({"world": CAMERA_WORLD, "duration": 9.0}, 0)
    for _ in range(14):
        tick = simulator.step(Command.of("yield"))
    folder.mkdir(parents=True, exist_ok=True)
    for name, times in ENLARGED.items():
        picture = Image.fromarray(tick.channels[name].get())
        size = picture.width * times, picture.height * times
        file = folder / f"{name.replace('_', '-')}.png"
        picture.resize(size, Image.Resampling.NEAREST).save(file, optimize=True)


def run_scenarios() -> Path:
    """The evidence of the built-in scenarios, all of them, with the aggressive planner."""
    command = ["--dura-scenarios", "--dura-generator=aggressive", f"--dura-evidence={EVIDENCE}"]
    done = subprocess.run([sys.executable, "-m", "pytest", *command], cwd=ROOT, check=False)
    if done.returncode != 1:
        sys.exit(f"the gate should have failed with exit code 1, and ended with {done.returncode}")
    return ROOT / EVIDENCE


def take(report: Path, folder: Path) -> None:
    """All pictures of a report, into a folder."""
    from playwright.sync_api import sync_playwright

    executable = shutil.which("chromium") or shutil.which("chromium-browser")
    if executable is None:
        sys.exit("there is no chromium on the path")
    folder.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=list(FLAGS))
        page = opened(browser, report, viewport=WIDE)
        page.screenshot(path=folder / "report.png")
        page = opened(browser, report, viewport=WIDE, color_scheme="dark")
        page.evaluate("document.getElementById('scenarios').scrollIntoView()")
        page.screenshot(path=folder / "report-dark.png")
        page = opened(browser, report, viewport=WIDE)
        play(page)
        page.screenshot(path=folder / "player.png")
        page = opened(
            browser, report, viewport=NARROW, color_scheme="dark", device_scale_factor=1.5
        )
        play(page)
        page.screenshot(path=folder / "phone.png")
        browser.close()
    for picture in sorted(folder.glob("*.png")):
        if picture.stat().st_size > LARGEST:
            sys.exit(f"{picture} has {picture.stat().st_size} bytes, more than {LARGEST}")


def opened(browser: Any, report: Path, **options: Any) -> Any:
    """The report in a window of its own."""
    page = browser.new_context(**options).new_page()
    page.goto(report.resolve().as_uri())
    return page


def play(page: Any) -> None:
    """Open a player of an episode with a contact, at the contact, with its scene on top."""
    page.locator("#requirement-SAF-1 .counterexamples a[href^='#player-']").first.click()
    player = page.locator(".dura-player")
    player.wait_for()
    player.get_by_role("button", name="Jump to violation of SAF-1").click()
    player.locator("canvas").first.evaluate("one => one.scrollIntoView()")
    page.wait_for_timeout(300)


def main() -> None:
    """Take the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bundle", type=Path, help="evidence that is there already")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "screenshots")
    parser.add_argument("--cameras", action="store_true", help="only what the cameras show")
    given = parser.parse_args()
    take_cameras(given.out)
    if given.cameras:
        return
    bundle = given.bundle or run_scenarios()
    take(bundle / "report.html", given.out)


if __name__ == "__main__":
    main()
