"""How Sphinx builds the site: `make docs`, or `sphinx-build -W docs docs/_build/html`."""

from __future__ import annotations

import logging
import os
import shutil
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE / "_ext"), str(HERE / "browser")]

# Before furo's colours do it, at a level at which the examples' servers and fonts tell everything.
logging.basicConfig(level=logging.WARNING)
# Small matrices: one thread is faster, and the figures of the gallery are the same on every machine.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import browser_page  # noqa: E402 - after the path
import gallery_scraper  # noqa: E402
from api_names import context as autosummary_context  # noqa: E402, F401
from api_names import filenames as autosummary_filename_map  # noqa: E402, F401
from sphinx.application import Sphinx  # noqa: E402
from sphinx_gallery.sorting import ExplicitOrder  # noqa: E402

import lieednn_sim  # noqa: E402

project = "lieednn_sim"
author = "The lieednn_sim authors"
copyright = author
release = version = lieednn_sim.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.intersphinx",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "matplotlib.sphinxext.plot_directive",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "sphinx-mathjax-offline",
    "measured",
    "registry_table",
    "api_names",
]
exclude_patterns = ["_build", "_templates", "gallery/*.*", "drawings", "browser"]
nitpicky = False
# sphinx-gallery's settings hold functions; its copies of the examples are below the examples.
suppress_warnings = ["config.cache", "sphinx_gallery.duplicate_filename"]

html_theme = "furo"
html_title = "lieednn_sim"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False

myst_enable_extensions = ["amsmath", "attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

templates_path = ["_templates"]
default_role = "name"
smartquotes_action = "e"  # dots alone: the primes of derivatives stay, and the dashes of options
add_module_names = False
python_maximum_signature_line_length = 90
autosummary_generate = True
autodoc_typehints = "signature"
autodoc_type_aliases = {"ArrayLike": "ArrayLike", "Floats": "Floats"}
autodoc_member_order = "bysource"
napoleon_numpy_docstring = False
napoleon_attr_annotations = False
napoleon_use_ivar = True
napoleon_use_rtype = False

copybutton_exclude = ".linenos, .gp, .go"

# Links to the pages of others take a network; without it their names stay words.
intersphinx_mapping = (
    {
        "python": ("https://docs.python.org/3", None),
        "numpy": ("https://numpy.org/doc/stable", None),
        "scipy": ("https://docs.scipy.org/doc/scipy", None),
        "matplotlib": ("https://matplotlib.org/stable", None),
        "gymnasium": ("https://gymnasium.farama.org", None),
    }
    if "DOCS_WITH_NETWORK" in os.environ
    else {}
)

plot_formats = ["svg"]
plot_html_show_formats = False
plot_html_show_source_link = False
plot_working_directory = str(HERE)

# The order of the cards; an example that is not listed comes last.
EXAMPLES = (
    *(
        "retargeting",
        "window",
        "straight_line",
        "own_urdf_table",
        "plan_in_model",
        "luffing_crane",
        "pick_and_place",
        "plan_in_menagerie",
        "plan_in_robosuite",
        "push_and_return",
        "moving_target",
        "moving_obstacle",
        "action_chunks",
    ),
    *("task_boom", "task_harvester", "task_crane", "settling_load"),
    *("demonstrations_fan", "blending", "payload_and_friction", "batch_of_256", "planner_figure", "environment"),
    *("own_certificate", "paper_figure", "algorithm_1", "*"),
)
# Examples that need models which are not the project's: they are shown, not run, beside a page that is kept.
KEPT = "|".join(sorted(path.stem for path in (HERE / "_static" / "kept").glob("*.html")))
gallery_scraper.EXTRA.mkdir(parents=True, exist_ok=True)
html_extra_path = [str(gallery_scraper.EXTRA), "../results/reference/comparison.html"]
sphinx_gallery_conf = {
    "examples_dirs": ["gallery"],
    "gallery_dirs": ["gallery/_made"],
    "filename_pattern": rf"/(?!({KEPT})\.py)\w+\.py$",
    "within_subsection_order": ExplicitOrder([name if name == "*" else f"{name}.py" for name in EXAMPLES]),
    "reset_argv": gallery_scraper.empty_directory,
    # In this order, so that a picture of the arm is the thumbnail where there is one.
    "image_scrapers": (gallery_scraper.written_files, gallery_scraper.charts),
    "thumbnail_size": (480, 336),
    "capture_repr": (),  # what an example prints is its output
    "min_reported_time": float("inf"),
    "reference_url": {"lieednn_sim": None},  # names in the code link to the API reference
    "abort_on_example_error": True,
    "show_signature": False,
    "download_all_examples": False,
    "notebook_extensions": set(),
    "write_computation_times": False,
    "remove_config_comments": True,
}


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("builder-inited", make_browser_page)
    app.connect("html-page-context", keep_sidebar_short, priority=100)
    app.connect("build-finished", keep_needed_mathjax, priority=900)


def make_browser_page(app: Sphinx) -> None:
    """Make the page in which an arm moves, if this is the site."""
    if app.builder.format == "html":
        browser_page.write_or_say_why_not(gallery_scraper.EXTRA / "browser.html")


def keep_sidebar_short(app: Sphinx, page: str, template: str, context: dict[str, Any], _: Any) -> None:
    """Leave the objects of the API out of every page's sidebar, which would be most of the site's size."""
    if whole := context.get("toctree"):
        context["toctree"] = lambda **options: whole(**{**options, "maxdepth": 2})


def keep_needed_mathjax(app: Sphinx, _: Exception | None) -> None:
    """Delete what no page loads of MathJax, 20 MB."""
    mathjax = Path(app.outdir) / "_static" / "mathjax"
    for unused in (mathjax / "input" / "asciimath.js", mathjax / "output" / "svg", *mathjax.glob("*.js")):
        if unused.is_dir():
            shutil.rmtree(unused)
        elif unused.name != "tex-chtml.js":
            unused.unlink(missing_ok=True)
