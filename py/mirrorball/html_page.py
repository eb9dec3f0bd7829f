"""Tables and figures as one self-contained HTML page, without scripts or other files."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mirrorball.output_file import replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CSS = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 1120px; margin: 2em auto; padding: 0 1em; color: #222; }
img { max-width: 100%; }
table { border-collapse: collapse; margin: 0.8em 0; }
td, th { padding: 0.2em 1.2em 0.2em 0; text-align: left; border-bottom: 1px solid #e4e4e4; vertical-align: top; }
h2 { margin: 1.6em 0 0.2em; font-size: 1.15em; }
"""


def picture(figure: Figure, heading: str = "") -> str:
    """A figure under its heading, as PNG inside the page."""
    pixels = io.BytesIO()
    figure.savefig(pixels, format="png", pil_kwargs={"compress_level": 1})
    return inline(pixels.getvalue(), heading)


def inline(png: bytes, heading: str = "") -> str:
    """A PNG under its heading."""
    said = html.escape(heading)
    title = f"<h2>{said}</h2>\n" if heading else ""
    return f'{title}<img alt="{said}" src="data:image/png;base64,{base64.b64encode(png).decode("ascii")}">'


def png_bytes(image: NDArray[np.uint8]) -> bytes:
    """An image, rows × columns × (red, green, blue), as PNG."""
    from matplotlib.image import imsave

    pixels = io.BytesIO()
    imsave(pixels, image, format="png")
    return pixels.getvalue()


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table; texts are escaped."""
    cells = "".join(f"<th>{html.escape(text)}</th>" for text in head)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(text)}</td>" for text in row) + "</tr>\n" for row in rows)
    return f"<table><tr>{cells}</tr>\n{body}</table>"


def whole(title: str, sections: Sequence[str]) -> str:
    """The page's text."""
    said = html.escape(title)
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{said}</title>
<style>{CSS}</style></head><body>
<h1>{said}</h1>
{"".join(sections)}
</body></html>
"""


def write(folder: Path, *, title: str, sections: Sequence[str]) -> Path:
    """Writes index.html into a folder (created if missing) and returns its path."""
    folder.mkdir(parents=True, exist_ok=True)
    page = folder / "index.html"
    with replacing(page) as part:
        part.write_text(whole(title, sections), encoding="utf-8")
    return page
