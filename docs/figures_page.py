"""The page of the paper's figures: drawn, quickly and small, when the site is built."""

import os
from pathlib import Path

FOLDER = Path(__file__).parent / "figures"

HEAD = """# The figures of the paper

Drawn when this page was made, quickly and small, by one command:

```console
$ gpureg figures paper/ --quick
```

Without `--quick` they are larger, in two minutes on two cores. Each can be drawn of your own picture, mesh or curve
(`--image`, `--mesh`, `--curve`), and one by itself (`--only 3`); all numbers are beside it as JSON. What the paper
gives is taken as it is. What it leaves open is said under each figure.
"""


def draw(app=None):
    """Draw what is not there yet, and write the page."""
    from gpureg.figures import FIGURES, Inputs, draw_figures

    FOLDER.mkdir(exist_ok=True)
    page = [HEAD]
    files = [FOLDER / f"fig{k}.md" for k in FIGURES]
    if not all(path.exists() for path in files):
        inputs = Inputs(quick=True, backend=os.environ.get("GPUREG_BACKEND", "auto"))
        for text, (drawn, path, _) in zip(files, draw_figures(FOLDER, inputs), strict=True):
            # without the marks of mathematics that matplotlib reads
            settings = drawn.settings.replace("$", "")
            words = [f"## {drawn.title}", f"![{drawn.title}](figures/{path.name})", drawn.see, f"Settings: {settings}"]
            text.write_text("\n\n".join(words) + "\n", "utf-8")
    page += [path.read_text("utf-8") for path in files]
    (FOLDER.parent / "figures.md").write_text("\n".join(page), "utf-8")
