"""Takes a picture of these pages: of one of our pages in a browser, or of what a command of ours wrote or printed.

python docs/take_picture.py http://127.0.0.1:8766/#SECRET docs/page.webp --fill '#send_x=1.1' --fill '#send_y=1.5'
python docs/take_picture.py runs/swim/report.html docs/swim.webp --element .tank
python docs/take_picture.py depth.png docs/depth-map.webp
python docs/take_picture.py own.png lent.png docs/lighting.webp
python docs/take_picture.py doctor.txt docs/doctor.webp
"""

from __future__ import annotations

import argparse
import io
import shutil
import time
from html import escape
from pathlib import Path
from urllib.parse import quote

from PIL import Image

MOST_BYTES = 80_000
MOST_PX = 1000  # wide: what a page shows
QUALITIES = range(90, 20, -10)
SETTLE_S = 6.0  # until pictures and states have come


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="+", help="an address, a report, a text, or pictures of one height, side by side")
    parser.add_argument("out", type=Path, help="a .webp file")
    parser.add_argument("--element", help="CSS selector: this part of the page alone")
    parser.add_argument("--size", default="1280x800", help="of the browser's window")
    parser.add_argument("--fill", action="append", default=[], metavar="SELECTOR=TEXT", help="a field, before")
    parser.add_argument("--click", action="append", default=[], metavar="SELECTOR", help="a button, after")
    asked = parser.parse_args()
    first = asked.what[0]
    if first.endswith(".txt"):
        taken = shot(printed(Path(first).read_text(encoding="utf-8")), "pre", asked.size, [], [])
    elif first.endswith(".html") or "://" in first:
        address = first if "://" in first else Path(first).resolve().as_uri()
        taken = shot(address, asked.element, asked.size, asked.fill, asked.click)
    else:
        taken = beside([Image.open(name).convert("RGB") for name in asked.what])
    asked.out.write_bytes(small(taken.convert("RGB")))


def printed(text: str) -> str:
    """What a command printed, as the address of a page."""
    style = "font: 13px monospace; white-space: pre-wrap; width: 115ch; padding: 1em; background: #f4f6f8"
    return "data:text/html;charset=utf-8," + quote(f'<pre style="{style}">{escape(text.rstrip())}</pre>')


def beside(pictures: list[Image.Image], gap_px: int = 10) -> Image.Image:
    """All in one row, on white."""
    width = sum(one.width + gap_px for one in pictures) - gap_px
    row = Image.new("RGB", (width, max(one.height for one in pictures)), "white")
    left = 0
    for one in pictures:
        row.paste(one, (left, 0))
        left += one.width + gap_px
    return row


def shot(address: str, element: str | None, size: str, fill: list[str], click: list[str]) -> Image.Image:
    """What a browser shows."""
    from playwright.sync_api import sync_playwright

    width, height = map(int, size.split("x"))
    with sync_playwright() as tools:
        browser = tools.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": width, "height": height}, color_scheme="light")
        page.goto(address)
        page.evaluate("document.querySelectorAll('details:not([id])').forEach(one => one.open = true)")
        time.sleep(SETTLE_S)
        for field in fill:
            page.fill(*field.split("=", 1))
        for button in click:
            page.click(button)
            time.sleep(1.0)
        time.sleep(1.0)
        taken = page.locator(element).first.screenshot() if element else page.screenshot()
        browser.close()
    return Image.open(io.BytesIO(taken))


def small(picture: Image.Image) -> bytes:
    """As WebP, of the best quality that is small enough. Raises ValueError where none is."""
    if picture.width > MOST_PX:
        picture = picture.resize((MOST_PX, round(picture.height * MOST_PX / picture.width)), Image.Resampling.LANCZOS)
    for quality in QUALITIES:
        packed = io.BytesIO()
        picture.save(packed, "WEBP", quality=quality, method=6)
        if packed.tell() <= MOST_BYTES:
            return packed.getvalue()
    raise ValueError(f"larger than {MOST_BYTES} bytes at any quality")


if __name__ == "__main__":
    main()
