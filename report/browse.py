"""Writes the pages of this folder as one HTML file that needs no other, for a release.

    python report/browse.py REPORT.html

README.md comes first, then the pages in the order in which its table links them. Links between pages lead to their
place in the file, pictures are in it; a link to anything else of the repository is its text alone.
"""

from __future__ import annotations

import base64
import re
import sys
from pathlib import Path

from markdown_it import MarkdownIt

HERE = Path(__file__).resolve().parent
STYLE = """
:root { color-scheme: light dark; font: 15px/1.5 system-ui, sans-serif }
body { margin: 0 auto; max-width: 75rem; padding: 1rem 1.5rem 4rem }
nav { background: Canvas; border-bottom: 1px solid GrayText; padding: .5rem 0; position: sticky; top: 0 }
nav a { margin-right: 1rem }
section { scroll-margin-top: 3rem }
table { border-collapse: collapse; display: block; font-size: .87rem; overflow-x: auto }
td, th { border: 1px solid color-mix(in srgb, GrayText 45%, transparent); padding: .2rem .5rem }
td, th { font-variant-numeric: tabular-nums; text-align: left; vertical-align: top }
pre { background: color-mix(in srgb, GrayText 12%, transparent); overflow-x: auto; padding: .5rem }
img { background: white; max-width: 100% }
"""


def page_names(readme: str) -> list[str]:
    """README.md and the pages that it links, each once."""
    return ["README.md", *dict.fromkeys(re.findall(r"\]\(([\w-]+\.md)\)", readme))]


def section(page: Path, pages: list[str]) -> str:
    """A page as HTML, under its name."""
    text = page.read_text("utf-8")
    rendered = MarkdownIt("commonmark").enable("table").render(re.sub(r"<!--.*?-->\n?", "", text, flags=re.DOTALL))
    rendered = re.sub(r'<a href="([^"]*)">(.*?)</a>', lambda found: link(found[1], found[2], pages), rendered)
    rendered = re.sub(r'src="(pictures/[^"]+)"', lambda found: f'src="{embedded(page.parent / found[1])}"', rendered)
    return f'<section id="{page.stem}">\n{rendered}</section>\n'


def link(target: str, text: str, pages: list[str]) -> str:
    file = target.partition("#")[0]
    if file in pages:
        return f'<a href="#{Path(file).stem}">{text}</a>'
    return f'<a href="{target}">{text}</a>' if target.startswith("https://") else text


def embedded(picture: Path) -> str:
    return "data:image/png;base64," + base64.b64encode(picture.read_bytes()).decode()


def whole(folder: Path = HERE) -> str:
    """All pages as one HTML document."""
    pages = page_names((folder / "README.md").read_text("utf-8"))
    sections = [section(folder / name, pages) for name in pages]
    nav = " ".join(f'<a href="#{Path(name).stem}">{Path(name).stem.replace("README", "all")}</a>' for name in pages)
    head = f'<meta charset="utf-8"><title>decogs: the report</title><style>{STYLE}</style>'
    return f'<!doctype html><html lang="en">{head}<nav>{nav}</nav>\n{"".join(sections)}</html>\n'


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(whole(), "utf-8")
