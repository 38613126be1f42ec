"""The documentation site: ``make docs`` builds it into build/docs."""

import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(ROOT))

import figures_page  # noqa: E402
import sphinx.ext.autosummary  # noqa: E402

import gpureg  # noqa: E402

project = "gpureg"
author = "The gpureg developers"
copyright = f"2026, {author}"
version = release = gpureg.__version__

# so that a summary does not end after "(eq."
sphinx.ext.autosummary.WELL_KNOWN_ABBREVIATIONS += ("eq.", "sec.")

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "numpydoc",
    "myst_parser",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["figures/**", "gallery/**/*.ipynb", "gallery/**/*.py", "gallery/**/*.md5", "gallery/**/*.zip"]
templates_path = ["_templates"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
nitpicky = False

autosummary_generate = True
autodoc_typehints = "none"  # the types are in the docstrings
autodoc_member_order = "bysource"
numpydoc_show_class_members = False  # the template lists them
numpydoc_class_members_toctree = False
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3
suppress_warnings = ["config.cache"]

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "image_scrapers": ("pictures.scraper",),
    "reset_modules": (),
    "capture_repr": (),
    "subsection_order": [f"../examples/{name}" for name in ("images", "graphs", "meshes", "solvers")],
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "plot_gallery": True,
    "remove_config_comments": True,
}

html_theme = "pydata_sphinx_theme"
html_title = "gpureg"
html_show_sourcelink = False
html_theme_options = {
    "show_prev_next": True,
    "header_links_before_dropdown": 6,
    "navigation_with_keys": False,
    "show_toc_level": 2,
    "secondary_sidebar_items": ["page-toc"],
    "navbar_end": ["theme-switcher", "navbar-icon-links"],
}
html_static_path = ["_static"]
html_css_files = ["site.css"]
# only the gallery and the reference have subpages
html_sidebars = {
    name: []
    for name in (
        "index", "first_steps", "figures", "command_line", "images", "simplification", "meshes", "parameters",
        "coming_from", "solvers", "quality", "performance", "backends", "mathematics", "search", "genindex",
    )
}  # fmt: skip


def _plain_bars(app, what, name, obj, options, lines):
    """Escape | and * in plain text, so that reStructuredText does not read |f(u)| as a substitution."""
    inside = False
    for k, line in enumerate(lines):
        inside = inside or line.startswith(">>>")
        if not line.strip():
            inside = False
        if inside or line.startswith((">>>", "...", ".. ")):
            continue
        lines[k] = _outside_of_code(line)


def _outside_of_code(line):
    parts = line.split("``")
    for k in range(0, len(parts), 2):
        words = parts[k].split(":math:`")
        rest = [words[0]]
        for word in words[1:]:
            formula, after = word.split("`", 1) if "`" in word else (word, "")
            rest.append(f"{formula}`{_escaped(after)}")
        rest[0] = _escaped(rest[0])
        parts[k] = ":math:`".join(rest)
    return "``".join(parts)


def _escaped(text):
    # numpydoc has escaped the stars of parameters such as *args already
    return text.replace("\\*", "\0").replace("|", r"\|").replace("*", r"\*").replace("\0", "\\*")


def setup(app):
    """Connect the events of Sphinx; the figures are drawn before the pages are read."""
    # before numpydoc, which makes reStructuredText of the sections
    app.connect("autodoc-process-docstring", _plain_bars, priority=100)
    app.connect("builder-inited", figures_page.draw)
