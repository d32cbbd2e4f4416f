"""Make the pictures of docs/gallery.md by the commands that stand under them there.

    python scripts/gallery.py FOLDER [--only NAME ...]

The commands of the page run in FOLDER, in the page's order. An entry is a picture, a text whose
last word in backticks is the file that the commands leave, and a block of commands. A PNG gets
a palette and at most 1,600 pixels of width. A film becomes six of its instants where the page
shows a JPEG. An address in place of a file is photographed in a browser while the last command
runs (playwright and Chromium). `--only scissor` makes docs/images/gallery-scissor.* alone.
"""

import argparse
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs/gallery.md"
ENTRY = re.compile(r"!\[[^\]]*\]\(([^)]+)\)\n\n((?:(?!```).)*?)```bash\n(.*?)```", re.DOTALL)
NAMES = """optipromp() {{ "{0}" -m optipromp "$@"; }}
python() {{ "{0}" "${{@/#scripts/{1}/scripts}}"; }}
"""
PHOTOGRAPH = "photograph"  # of a page in a browser
WIDE, SMALL = 1600, (480, 270)  # [pixel] of a picture; of an instant of a film
FLAGS = "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"


def entries() -> list[tuple[Path, str, str]]:
    """Of each entry: the picture, the file or address that it is made of, the commands."""
    found = ENTRY.findall(PAGE.read_text("utf-8"))
    return [
        (PAGE.parent / shown, re.findall(r"`([^`]+)`", said)[-1], commands)
        for shown, said, commands in found
    ]


def run(commands: str, folder: Path) -> subprocess.Popen[bytes]:
    """Commands of the page, by this interpreter."""
    script = "set -euo pipefail\n" + NAMES.format(sys.executable, ROOT) + commands
    kept = os.environ | {
        "PYTHONPATH": os.pathsep.join(map(str, ROOT.glob("packages/*/src"))),
        "MPLBACKEND": "Agg",
    }
    return subprocess.Popen(["bash", "-c", script], cwd=folder, env=kept, start_new_session=True)


def photograph(address: str, path: Path, patience: float) -> None:
    """A picture of a page in a browser, once it has been drawn for a while [s]."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path="/usr/bin/chromium", args=[*FLAGS])
        tab = browser.new_page(viewport={"width": 1280, "height": 800})
        tab.set_default_timeout(6e5)
        for _ in range(120):  # the page opens once its plan is made
            try:
                tab.goto(address)
                break
            except Exception:
                time.sleep(1.0)
        tab.wait_for_timeout(1e3 * patience)
        # what the browser says of its own speed is not the page's
        tab.add_style_tag(content=".mantine-Notification-root { display: none }")
        tab.screenshot(path=path, timeout=6e5)  # [ms] the processor draws
        browser.close()


def instants(film: Path) -> Image.Image:
    """Six instants of a film, evenly spaced, in two rows."""
    frames = Image.open(film)
    sheet = Image.new("RGB", (3 * SMALL[0], 2 * SMALL[1]))
    for k in range(6):
        frames.seek(k * (frames.n_frames - 1) // 5)
        place = (k % 3) * SMALL[0], (k // 3) * SMALL[1]
        sheet.paste(frames.convert("RGB").resize(SMALL, Image.Resampling.LANCZOS), place)
    return sheet


def keep(made: Path, shown: Path) -> None:
    """Put a picture where the page shows it."""
    if shown.suffix == ".gif":
        shown.write_bytes(made.read_bytes())
    elif made.suffix == ".gif":
        instants(made).save(shown, quality=85)
    else:
        picture = Image.open(made).convert("RGB")
        picture.thumbnail((WIDE, WIDE), Image.Resampling.LANCZOS)
        if shown.suffix == ".png":
            # an octree's palette keeps the thin vivid lines of a page
            shades = Image.Quantize.FASTOCTREE if made.stem == PHOTOGRAPH else None
            picture = picture.quantize(256, shades, dither=Image.Dither.NONE)
        picture.save(shown, **({"optimize": True} if shown.suffix == ".png" else {"quality": 85}))
    print(shown.relative_to(ROOT), f"{shown.stat().st_size / 1e3:.0f} kB", flush=True)


def main() -> None:
    """Make all pictures, or those that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="*", default=None)
    parser.add_argument("--patience", type=float, default=120.0, help="[s] for a page in a browser")
    chosen = parser.parse_args()
    chosen.folder.mkdir(parents=True, exist_ok=True)
    for shown, made, commands in entries():
        if chosen.only is not None and shown.stem.removeprefix("gallery-") not in chosen.only:
            continue
        running = run(commands, chosen.folder)
        if made.startswith("http"):
            photograph(made, chosen.folder / f"{PHOTOGRAPH}.png", chosen.patience)
            os.killpg(running.pid, signal.SIGTERM)  # bash and its command
            made = f"{PHOTOGRAPH}.png"
        elif running.wait():
            raise SystemExit(f"failed: {commands}")
        keep(chosen.folder / made, shown)


if __name__ == "__main__":
    main()
