"""How the gallery runs its examples: each in an empty directory, whose pictures and turning pages enter the site."""

from __future__ import annotations

import shutil
import tempfile
import textwrap
from html import escape
from pathlib import Path
from typing import Any

from matplotlib import pyplot as plt
from sphinx_gallery.scrapers import figure_rst, matplotlib_scraper

import lieednn_sim as ls

# Below the site's root, for Sphinx's `html_extra_path`, which copies what is in the folder.
EXTRA = Path(__file__).parents[1] / "gallery" / "_made" / "extra"
PICTURES = {".png", ".jpg"}

_PAGE = """
.. raw:: html

   <figure class="turning">
   <iframe src="{address}" title="{title}" loading="lazy"></iframe>
   <figcaption>Drag to turn, scroll to zoom. <a href="{address}" target="_blank">Open alone</a></figcaption>
   </figure>

"""


def empty_directory(gallery_conf: dict[str, Any], script_vars: dict[str, Any]) -> list[str]:
    """The hook ``reset_argv``: let an example begin in an empty directory, and without arguments.

    sphinx-gallery runs an example in the folder of its ``src_file``. The directory goes with the variables.
    """
    script_vars["directory"] = tempfile.TemporaryDirectory(prefix="gallery")
    script_vars["src_file"] = str(Path(script_vars["directory"].name) / Path(script_vars["src_file"]).name)
    return []


def charts(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any], **how: Any) -> str:
    """The scraper of figures: without pictures in them of the class ``chart``, which the site turns round on dark."""
    shown = any(axes.images for number in plt.get_fignums() for axes in plt.figure(number).axes)
    found = str(matplotlib_scraper(block, block_vars, gallery_conf, **how))
    return found if shown or not found.strip() else f"\n.. container:: chart\n\n{textwrap.indent(found, '   ')}\n"


def written_files(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any], **_: Any) -> str:
    """The scraper: reStructuredText that shows what a block has written, pictures as pictures and pages in frames.

    A page without a picture of its own name gets a still of the last rollout, so that the example has a thumbnail; that
    picture stands for the page and is not shown beside it.
    """
    folder = Path(block_vars["directory"].name)
    seen: set[Path] = block_vars.setdefault("seen", set())
    new = sorted(set(folder.rglob("*")) - seen, key=lambda path: path.stat().st_mtime_ns)
    seen.update(new)
    pages = [path for path in new if path.suffix == ".html"]
    example = Path(block_vars["src_file"]).stem
    shown = []
    for path in new:
        is_poster = path.with_suffix(".html") in pages
        if path.suffix in PICTURES:
            kept = Path(next(block_vars["image_path_iterator"])).with_suffix(path.suffix)
            shutil.copyfile(path, kept)
            if not is_poster:
                shown.append(figure_rst([kept], gallery_conf["src_dir"], f"{path.stem} of the example {example}"))
        elif path.suffix == ".html":
            name = f"{example}-{path.stem}.html"
            (EXTRA / "turning").mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, EXTRA / "turning" / name)
            shown.append(_PAGE.format(address=f"../../turning/{name}", title=escape(f"{example}: {path.stem}")))
            values = [getattr(value, "rollout", value) for value in block_vars["example_globals"].values()]
            rollouts = [value for value in values if isinstance(value, ls.Rollout)]
            if rollouts and not any(path.with_suffix(suffix).exists() for suffix in PICTURES):
                still = next(block_vars["image_path_iterator"])
                ls.render_still(rollouts[-1], still, size=(800, 560), preset="draft")
    return "".join(shown)
