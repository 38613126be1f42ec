"""Pictures of the gallery: sphinx-gallery finds figures of pyplot only, so this writes the other figures of a block."""

from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst

_seen: dict[int, Figure] = {}


def scraper(block, block_vars, gallery_conf):
    """Write the figures that a block has made into variables."""
    paths = []
    for value in block_vars["example_globals"].values():
        if isinstance(value, Figure) and id(value) not in _seen:
            # stored, so that no later figure gets the same id
            _seen[id(value)] = value
            path = next(block_vars["image_path_iterator"])
            value.savefig(path, dpi=110)
            paths.append(path)
    return figure_rst(paths, gallery_conf["src_dir"])
