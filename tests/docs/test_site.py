"""The site builds without a warning, asks no other host for anything, and has every page, notebook and name.

CABINPOSE_SITE names a folder that `mkdocs build` has just filled (`make docs` does so); without it the site is built here.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import nbformat
import pytest
from nbclient.exceptions import CellExecutionError
from site_hooks import executed

ROOT = Path(__file__).resolve().parents[2]
FETCHING = {"script": "src", "img": "src", "iframe": "src", "source": "src", "video": "src", "object": "data", "link": "href"}
NOT_FETCHED = {"canonical", "next", "prev", "alternate"}  # relations of a link that a browser does not load
IN_STYLE = re.compile(r"(?:@import\s+|url\(\s*)[\"']?(?:https?:)?//", re.I)
PICTURES = {"1-generate": 1, "2-look": 2, "3-train": 0, "4-judge": 2, "5-own-car": 1, "6-own-detector": 1}
pytestmark = pytest.mark.slow


class Fetched(HTMLParser):
    """What a browser loads when it opens a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag == "link" and given.get("rel") in NOT_FETCHED:
            return
        if address := given.get(FETCHING.get(tag, "")):
            self.addresses.append(address)


def foreign(text: str, *, style: bool = False) -> list[str]:
    """Addresses of other hosts that a page, or a style sheet, makes a browser load."""
    found = [match.group() for match in IN_STYLE.finditer(text)]
    return found if style else found + [a for a in Fetched(text).addresses if re.match(r"(?:https?:)?//", a)]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    built = os.environ.get("CABINPOSE_SITE")
    if built:
        yield (ROOT / built).resolve()
        return
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    yield folder


def test_no_page_asks_another_host_for_anything(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 40
    wrong = {page.name: found for page in pages if (found := foreign(page.read_text("utf-8")))}
    wrong |= {sheet.name: found for sheet in site.rglob("*.css") if (found := foreign(sheet.read_text("utf-8"), style=True))}
    assert wrong == {}


def test_what_another_host_is_asked_for_is_seen() -> None:
    assert foreign('<script src="https://cdn.example/x.js"></script>') == ["https://cdn.example/x.js"]
    assert foreign('<link rel="stylesheet" href="//fonts.example/css">') == ["//fonts.example/css"]
    assert foreign("<style>@import 'https://fonts.example/css'; a { background: url(//b.example/c.png) }</style>")
    assert foreign("a { src: url('https://fonts.example/a.woff2') }", style=True)
    assert foreign('<a href="https://example.org">x</a><img src="images/x.png"><link rel="canonical" href="https://e.org">') == []


def test_every_page_of_the_documentation_is_on_the_site(site: Path) -> None:
    docs = ROOT / "docs"
    pages = [page.relative_to(docs).with_suffix(".html").as_posix() for page in docs.rglob("*.md")]
    lacking = [page for page in pages if not (site / page.replace("README.html", "index.html")).exists()]
    assert pages
    assert lacking == []


@pytest.mark.parametrize("code", ["1 / 0", "import sys\nprint('Traceback', file=sys.stderr)"])
def test_a_notebook_that_fails_or_prints_a_traceback_ends_the_build(code: str, tmp_path: Path) -> None:
    path = tmp_path / "0-fails.ipynb"
    nbformat.write(nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(code)]), path)
    with pytest.raises((CellExecutionError, RuntimeError), match=r"ZeroDivisionError|0-fails.ipynb: Traceback"):
        executed(path)


def test_notebooks_show_what_they_print_and_draw(site: Path) -> None:
    assert sorted(PICTURES) == sorted(path.stem for path in (ROOT / "docs" / "notebooks").glob("*.ipynb"))
    for name, count in PICTURES.items():
        page = (site / "notebooks" / f"{name}.html").read_text("utf-8")
        drawn = re.findall(rf'src="({name}-\d+\.png)"', page)
        assert len(drawn) == count, name
        assert all((site / "notebooks" / picture).stat().st_size > 5_000 for picture in drawn)
        assert 'class="output"' in page
        assert f'href="{name}.ipynb"' in page
        assert (site / "notebooks" / f"{name}.ipynb").exists()


@pytest.mark.parametrize(
    ("page", "names"),
    [
        ("index", ["open", "load_model", "generate", "evaluate_predictions"]),
        ("store", ["store.open_dataset", "store.Manifest", "store.write_predictions", "store.recording.Recording"]),
        ("scene", ["scene.cabin.load_cabin", "scene.body.Phenotype", "scene.sensor.Sensor", "scene.sensor.simulate"]),
        ("synth", ["synth.generate", "synth.SynthConfig", "synth.CabinScene.belted"]),
        ("estimate", ["estimate.FrameDataset", "estimate.JointPredictor.__call__", "estimate.fit"]),
        ("evaluate", ["evaluate.evaluate", "evaluate.Report.value", "evaluate.METRICS", "evaluate.mocap.dfe"]),
        ("align", ["align.calibrate", "align.align_takes"]),
        ("record", ["record.load_rig", "record.begin", "record.sources.DeviceSource"]),
        ("signals", ["signals.FrameSource", "signals.estimate_delay"]),
        ("core", ["core.ConfigError", "core.Predictor.predict", "core.Visibility"]),
    ],
)
def test_the_api_pages_have_the_names_that_scripts_use(site: Path, page: str, names: list[str]) -> None:
    text = (site / "api" / f"{page}.html").read_text("utf-8")
    assert [name for name in names if f'id="cabinpose.{name}"' not in text] == []
