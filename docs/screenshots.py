"""Make pictures of reports and their players, and of what the cameras show.

``python docs/screenshots.py`` runs four sessions: one that passes, one with the planner that is
attacked, the one of the README, one with every fault of the catalogue. It
photographs each report at three widths, light and dark, into ``screenshots/``, and keeps in
``docs/screenshots`` those that the docs show. It needs Debian's Chromium and Playwright;
``--bundle NAME=DIR`` takes evidence that is there already. ``--cameras`` makes the pictures of the
two cameras alone, and needs none of these.
"""  # noqa: INP001 - a script, no package

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from itertools import product
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
SESSIONS = {
    "green": [],
    "tactical": ["--dura-generator=tactical"],
    "aggressive": ["--dura-generator=aggressive", "--dura-select=*/sudden/*-c*"],
    "catalogue": [
        "--dura-generator=tactical", "--dura-faults=catalogue",
        "--dura-select=intersection/nominal", "--dura-runs=3",
    ],
}  # fmt: skip
"""Options of each session, by the name of its report."""
FLAGS = (
    "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-quic",
    "--disable-component-update", "--disable-sync", "--no-first-run",
)  # fmt: skip
WINDOWS = {1400: 900, 900: 900, 390: 844}
"""Heights of windows by their widths."""
SCHEMES = ("light", "dark")
VIEWS = ("overview", "requirements", "plots")
KEPT = {
    "report.png": "aggressive-overview-1400-light.png",
    "report-dark.png": "aggressive-requirements-1400-dark.png",
    "player.png": "aggressive-player-1400-light.png",
    "phone.png": "aggressive-player-390-dark.png",
}
"""Pictures that the docs show, by their names there."""
LARGEST = 150_000
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


def run_session(name: str, folder: Path) -> Path:
    """Run a session of the built-in scenarios, and return its evidence."""
    place = folder / name
    place.mkdir()
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--dura-scenarios"]
    done = subprocess.run([*command, *SESSIONS[name]], cwd=place, check=False)
    if done.returncode not in (0, 1):
        sys.exit(f"the session ended with exit code {done.returncode}")
    return place / "dura-evidence"


def take_reports(bundles: dict[str, Path], folder: Path) -> None:
    """Photograph the views of each report, and the first player that a card leads to.

    How high each first view is, in pixels, is printed.
    """
    from playwright.sync_api import sync_playwright

    executable = shutil.which("chromium") or shutil.which("chromium-browser")
    if executable is None:
        sys.exit("there is no chromium on the path")
    folder.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=list(FLAGS))
        for (name, bundle), (width, height), scheme in product(
            bundles.items(), WINDOWS.items(), SCHEMES
        ):
            window = {"width": width, "height": height}
            page = browser.new_context(viewport=window, color_scheme=scheme).new_page()
            page.goto((bundle / "report.html").resolve().as_uri())
            page.wait_for_timeout(100)
            high = page.evaluate("document.documentElement.scrollHeight")
            print(f"{name}, {width} px wide, {scheme}: {high} px high")  # noqa: T201
            for view in VIEWS:
                page.evaluate("view => { location.hash = view }", view)
                page.wait_for_timeout(100)
                page.screenshot(path=folder / f"{name}-{view}-{width}-{scheme}.png")
            if play(page):
                page.screenshot(path=folder / f"{name}-player-{width}-{scheme}.png")
            page.context.close()
        browser.close()


def play(page: Any) -> bool:
    """Open the player that the first card leads to; whether there is one."""
    page.evaluate("location.hash = 'overview'")
    buttons = page.locator(".card .button")
    if not buttons.count():
        return False
    buttons.first.click()
    player = page.locator(".dura-player")
    player.wait_for()
    player.locator("canvas").first.click()
    page.keyboard.press("v")  # to the violation
    page.locator("details.player.current").evaluate("each => each.scrollIntoView()")
    page.wait_for_timeout(300)
    return True


def keep(folder: Path, docs: Path) -> None:
    """Keep the pictures that the docs show, in few enough colours to be small."""
    from PIL import Image

    docs.mkdir(parents=True, exist_ok=True)
    for name, picture in KEPT.items():
        if (folder / picture).exists():
            small = (
                Image.open(folder / picture).convert("RGB").quantize(128, dither=Image.Dither.NONE)
            )
            small.save(docs / name, optimize=True)
    for picture in sorted(docs.glob("*.png")):
        if picture.stat().st_size > LARGEST:
            sys.exit(f"{picture} has {picture.stat().st_size} bytes, more than {LARGEST}")


def main() -> None:
    """Take the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--bundle", action="append", default=[], metavar="NAME=DIR",
        help="evidence that is there already; the others are not made then",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, default=ROOT / "screenshots", help="all pictures")
    parser.add_argument("--docs", type=Path, default=ROOT / "docs" / "screenshots")
    parser.add_argument("--cameras", action="store_true", help="only what the cameras show")
    given = parser.parse_args()
    take_cameras(given.docs)
    if given.cameras:
        return
    with tempfile.TemporaryDirectory() as folder:
        bundles = {name: Path(place) for name, _, place in (b.partition("=") for b in given.bundle)}
        bundles = bundles or {name: run_session(name, Path(folder)) for name in SESSIONS}
        take_reports(bundles, given.out)
    keep(given.out, given.docs)


if __name__ == "__main__":
    main()
