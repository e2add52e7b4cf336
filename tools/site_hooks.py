"""What `mkdocs build` does beside its plugins.

Notebooks become pages with their outputs, test marks of fences go, and the page of a room (`docs/api/ROOM.md`) gets its names.
A notebook runs in an empty folder while the site is built; one that fails ends the build. Its page is Markdown like any other, so
that style, search and the check of links are those of the site and no script of another host is needed.
"""

from __future__ import annotations

import base64
import re
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import faces
import nbclient
import nbformat
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

SECONDS = 300  # a cell
QUIET = "--log-level=ERROR"  # kernels warn of the port on this machine that they are asked through
_MARKED = re.compile(r"^```(python|console) run$", re.M)
_ROOM = re.compile(r"api/(?!index)(\w+)\.md")
_NOTEBOOK = re.compile(r"(\]\([^)\s]*)\.ipynb\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds a page, and the pictures on it, for each notebook."""
    for file in [file for file in files if file.src_uri.endswith(".ipynb")]:
        page = file.src_uri.removesuffix(".ipynb")
        notebook = executed(Path(file.abs_src_path or ""))
        text, pictures = as_markdown(notebook, Path(page).name)
        text += f"\n\n[Download this notebook]({Path(file.src_uri).name}){{ download }}\n"
        files.append(File.generated(config, f"{page}.md", content=text))
        for name, data in pictures.items():
            files.append(File.generated(config, f"{Path(page).parent.as_posix()}/{name}", content=data))
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """The Markdown without marks of blocks that tests run, with links to notebooks leading to their pages, and a room's names."""
    text = _MARKED.sub(r"```\1", markdown)
    if room := _ROOM.fullmatch(page.file.src_uri):
        text += f"\n{faces.page(f'cabinpose.{room[1]}')}\n"
    return _NOTEBOOK.sub(r"\1.md)", text).replace(".md){ download }", ".ipynb){ download }")


def executed(path: Path) -> nbformat.NotebookNode:
    """A notebook run from its first cell to its last in an empty folder, with its outputs."""
    notebook = nbformat.read(path, as_version=4)
    with TemporaryDirectory() as folder:
        resources = {"metadata": {"path": folder}}
        nbclient.NotebookClient(notebook, timeout=SECONDS, resources=resources, extra_arguments=[QUIET]).execute()
    outputs = (output for cell in notebook.cells for output in cell.get("outputs", ()))
    if told := [output.text for output in outputs if output.get("name") == "stderr" and "Traceback" in output.text]:
        raise RuntimeError(f"{path.name}: {told[0]}")  # one that the notebook caught, and went on
    return notebook


def as_markdown(notebook: nbformat.NotebookNode, name: str) -> tuple[str, dict[str, bytes]]:
    """The page of an executed notebook, and its pictures by file name; `name` begins theirs."""
    blocks, pictures = [], {}
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            blocks.append(cell.source)
            continue
        blocks.append(f"```python\n{cell.source}\n```")
        for output in cell.outputs:
            picture, text = shown(output)
            if picture:
                file = f"{name}-{len(pictures) + 1}.png"
                pictures[file] = picture
                blocks.append(f"![What the code above draws]({file})")
            elif text:
                blocks.append(f'<div class="output" markdown>\n\n```text\n{text.rstrip()}\n```\n\n</div>')
    return "\n\n".join(blocks), pictures


def shown(output: Any) -> tuple[bytes, str]:
    """PNG and text of one output of a cell; empty where it has none, and for what goes to stderr."""
    if output.output_type == "stream":
        return b"", output.text if output.name == "stdout" else ""
    data = output.get("data", {})
    return base64.b64decode(data.get("image/png", "")), data.get("text/plain", "")
