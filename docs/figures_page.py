"""The page of the paper's figures: drawn, quickly and small, when the site is built."""

import os
from pathlib import Path

FOLDER = Path(__file__).parent / "figures"

HEAD = """# The figures of the paper

The figures were drawn when this page was made, with small data, by one command:

```console
$ gpureg figures paper/ --quick
```

Without `--quick` the data are larger; this takes two minutes on two cores. `--image`, `--mesh` and `--curve` take
your own data, and `--only 3` draws one figure. All numbers are written as JSON too. Parameters that the paper gives are
used; the others are listed under each figure.
"""


def draw(app=None):
    """Draw the figures that are missing, and write the page."""
    from gpureg.figures import FIGURES, Inputs, draw_figures

    FOLDER.mkdir(exist_ok=True)
    page = [HEAD]
    files = [FOLDER / f"fig{k}.md" for k in FIGURES]
    if not all(path.exists() for path in files):
        inputs = Inputs(quick=True, backend=os.environ.get("GPUREG_BACKEND", "auto"))
        for text, (drawn, path, _) in zip(files, draw_figures(FOLDER, inputs), strict=True):
            # without matplotlib's marks of mathematics
            settings = drawn.settings.replace("$", "")
            words = [f"## {drawn.title}", f"![{drawn.title}](figures/{path.name})", drawn.see, f"Settings: {settings}"]
            text.write_text("\n\n".join(words) + "\n", "utf-8")
    page += [path.read_text("utf-8") for path in files]
    (FOLDER.parent / "figures.md").write_text("\n".join(page), "utf-8")
