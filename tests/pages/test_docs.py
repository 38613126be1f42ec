"""The documentation: nothing is left out of the reference, dead links are found, the notebook runs."""

from __future__ import annotations

import importlib
import inspect
import re
import sys
from collections import Counter
from pathlib import Path

import pytest

import gpureg as gr

ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
    ROOT / "bench" / "README.md",
    ROOT / "kernels" / "README.md",
]
# made when the site is built
MADE = ("docs/gallery", "docs/figures", "docs/api/")
pytestmark = pytest.mark.skipif(not (ROOT / "docs").exists(), reason="the documentation is not beside the tests")


def reference() -> dict[str, list[str]]:
    """The names of each module in the reference."""
    names: dict[str, list[str]] = {}
    module = ""
    for line in (ROOT / "docs" / "api.md").read_text("utf-8").splitlines():
        if found := re.match(r"\.\. currentmodule:: (\S+)", line):
            module = found[1]
        elif re.fullmatch(r"   [A-Za-z_]+", line):
            names.setdefault(module, []).append(line.strip())
    return names


def test_every_public_name_is_in_the_reference() -> None:
    names = reference()
    own = {name for name in gr.__all__ if not inspect.ismodule(getattr(gr, name)) and name != "__version__"}
    assert set(names["gpureg"]) == own
    modules = {name for name in gr.__all__ if inspect.ismodule(getattr(gr, name))}
    assert {f"gpureg.{name}" for name in modules} <= set(names)
    listed = [f"{module}.{name}" for module, own in names.items() for name in own]
    assert [name for name, times in Counter(listed).items() if times > 1] == []


def test_every_name_in_the_reference_says_what_it_is() -> None:
    found = [(importlib.import_module(module), name) for module, names in reference().items() for name in names]
    assert [f"{module.__name__}.{name}" for module, name in found if not inspect.getdoc(getattr(module, name))] == []


def functions(module: object) -> set[str]:
    """What is public is marked with @door."""
    return {
        name
        for name, value in vars(module).items()
        if inspect.isfunction(value) and hasattr(value, "__wrapped__") and value.__module__.startswith(module.__name__)  # type: ignore[attr-defined]
    }


@pytest.mark.parametrize("module", ["metrics", "operators", "plot", "presets", "sources", "spectral", "tuning"])
def test_every_function_of_a_public_module_is_in_the_reference(module: str) -> None:
    assert functions(importlib.import_module(f"gpureg.{module}")) <= set(reference()[f"gpureg.{module}"])


def exists(dotted: str) -> bool:
    """Whether a dotted name below gpureg is a module or something in one; attributes of an instance count."""
    found: object = gr
    path = "gpureg"
    for part in dotted.split(".")[1:]:
        path = f"{path}.{part}"
        if not hasattr(found, part):
            if inspect.isclass(found):
                fields = {name for c in found.__mro__ for name in inspect.get_annotations(c)}
                return part in fields | set(inspect.signature(found).parameters)
            try:
                importlib.import_module(path)
            except ImportError:
                return False
        found = getattr(found, part)
    return True


def dotted_names(text: str) -> set[str]:
    """Names such as gpureg.weights.patch or gr.Graph in a text; gr is gpureg."""
    # not the file names: gpureg.png
    found = re.findall(r"(?<![\w./])(?:gpureg|gr)((?:\.[A-Za-z_]\w*)+)(?![\w/])", text)
    return {f"gpureg{name}" for name in found}


def paths(text: str) -> set[str]:
    """Files and folders of the checkout that a text names: those that begin with one of its folders."""
    return set(re.findall(r"(?<![\w/.-])(?:gpureg|kernels|tests|bench|docs|examples|notebooks)/[\w/.]*\w", text))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_names_and_paths_in_the_pages_exist(page: Path) -> None:
    text = page.read_text("utf-8")
    wrong = [name for name in sorted(dotted_names(text)) if not exists(name)]
    # what a run writes is not in the checkout
    wrong += [
        path
        for path in sorted(paths(text))
        if not (ROOT / path).exists() and not path.startswith((*MADE, "bench/results"))
    ]
    for target in re.findall(r"\]\(<?([\w./-]+)[^)]*\)", re.sub(r"```.*?```", "", text, flags=re.S)):
        place = (page.parent / target).resolve()
        if not place.exists() and not place.relative_to(ROOT).as_posix().startswith(MADE):
            wrong.append(target)
    assert not wrong, wrong


def test_a_wrong_name_or_path_is_found() -> None:
    text = "`gr.weights.patch`, gpureg.graphs.csr, `gr.Interrupted.result`; gpureg/graphs/csr.py and gpureg/images/."
    assert dotted_names(text) == {"gpureg.weights.patch", "gpureg.graphs.csr", "gpureg.Interrupted.result"}
    assert all(map(exists, dotted_names(text)))
    assert paths(text) == {"gpureg/graphs/csr.py", "gpureg/images"}
    assert not exists("gpureg.weights.no") and not exists("gpureg.no.csr") and not exists("gpureg.Result.no")
    assert exists("gpureg.Result.gap")


def test_every_page_is_in_the_contents() -> None:
    text = (ROOT / "docs" / "index.md").read_text("utf-8")
    contents = set(re.findall(r"^[^<\n]+ <(\w+)>$", text[text.index("{toctree}") :], re.M))
    assert {page.stem for page in (ROOT / "docs").glob("*.md")} - {"index", "figures"} <= contents


def test_dead_links_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    links = importlib.import_module("links")
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "index.html").write_text('<p id="here">', "utf-8")
    good = (
        '<a href="sub/#here"></a><a href="#top" id="top"></a><a href="https://example.org/no"></a><a href="mailto:a@b">'
    )
    (tmp_path / "index.html").write_text(good, "utf-8")
    assert links.dead_links(tmp_path) == (2, [])
    (tmp_path / "index.html").write_text(
        '<a href="sub/index.html#gone"></a><img src="no.png"><a href="#no"></a><meta name="no"><a href="/a">', "utf-8"
    )
    _, dead = links.dead_links(tmp_path)
    assert [link for _, link in dead] == ["sub/index.html#gone", "no.png", "#no", "/a"]


def test_the_citation_names_this_version() -> None:
    text = (ROOT / "CITATION.cff").read_text("utf-8")
    assert re.search(r"^version: (\S+)$", text, re.M)[1] == gr.__version__  # type: ignore[index]
    assert "10.1007/s11263-008-0159-z" in text


@pytest.mark.filterwarnings("default")
def test_the_notebook_runs(tmp_path: Path) -> None:
    """As it is, from any folder; it holds no outputs, which would age, and each of its figures shows itself."""
    nbformat = pytest.importorskip("nbformat", reason="nbformat, of the extra 'dev', is not installed")
    nbclient = pytest.importorskip("nbclient", reason="nbclient, of the extra 'dev', is not installed")
    pytest.importorskip("ipykernel", reason="ipykernel, of the extra 'dev', is not installed")
    pytest.importorskip("skimage", reason="scikit-image, of the extra 'plot', is not installed")
    pytest.importorskip("matplotlib", reason="matplotlib, of the extra 'plot', is not installed")
    if sys.platform == "win32":
        import asyncio

        # the kernel's sockets need a loop that Windows does not take by itself
        asyncio.set_event_loop_policy(asyncio.WindowsSelectorEventLoopPolicy())
    book = nbformat.read(ROOT / "notebooks" / "tour.ipynb", as_version=4)
    nbformat.validate(book)
    cells = [cell for cell in book.cells if cell.cell_type == "code"]
    assert not any(cell.outputs or cell.execution_count for cell in cells)
    nbclient.NotebookClient(book, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    drawn = [cell for cell in cells if "gr.plot." in cell.source]
    assert len(drawn) == 6
    shown = [any("image/png" in output.get("data", {}) for output in cell.outputs) for cell in drawn]
    assert [cell.source for cell, there in zip(drawn, shown, strict=True) if not there] == []
