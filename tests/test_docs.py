"""The documentation: nothing is left out of the reference, dead links are found, the notebook runs."""

from __future__ import annotations

import importlib
import inspect
import re
import sys
from pathlib import Path

import pytest

import gpureg as gr

ROOT = Path(__file__).parent.parent
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
    for module, listed in names.items():
        assert len(listed) == len(set(listed))
        for name in listed:
            assert inspect.getdoc(getattr(importlib.import_module(module), name)), f"{module}.{name}"


def functions(module: object) -> set[str]:
    return {
        name
        for name, value in vars(module).items()
        if inspect.isfunction(value) and not name.startswith("_") and value.__module__.startswith(module.__name__)  # type: ignore[attr-defined]
    }


@pytest.mark.parametrize("module", ["metrics", "operators", "plot", "presets", "sources", "spectral", "tuning"])
def test_every_function_of_a_public_module_is_in_the_reference(module: str) -> None:
    assert functions(importlib.import_module(f"gpureg.{module}")) <= set(reference()[f"gpureg.{module}"])


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
    for cell in drawn:
        assert any("image/png" in output.get("data", {}) for output in cell.outputs)
