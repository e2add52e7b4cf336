"""The pictures of docs/studio.md: each tab in headless Chromium, light and dark, as PNG, and as WebP where those of the page lie.

    python -m tools.make_studio_pictures DATASET SEQUENCE SCENE.yaml OUT [--sizes 1280x800 1920x1080] [--webp docs/images]

Compare shows two models, Live the dataset SEQUENCE, frames that follow each other. Needs Debian's chromium and playwright.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, Literal

from PIL import Image

from benchmarks.studio import choose, page_of, studio

SCHEMES: tuple[Literal["light", "dark"], ...] = ("light", "dark")
TABS = ("Dataset", "Label", "Compare", "Live")


def scene_picture(scene: Path, out: Path, size: str, scheme: Literal["light", "dark"]) -> None:
    """The tab Scene with a person's joints."""
    width, height = map(int, size.split("x"))
    with studio(scene) as address, page_of(width, height, scheme) as page:
        page.goto(address)
        page.get_by_text("holds: nothing collides").wait_for()
        page.wait_for_timeout(5000)
        page.get_by_role("button", name="Accept").click()
        page.wait_for_timeout(2000)
        if page.get_by_role("button", name="Accept it").is_visible():  # where something is let go
            page.get_by_role("button", name="Accept it").click()
        page.get_by_role("tab", name="People").click()
        page.get_by_text("driver:").first.click()
        page.wait_for_timeout(5000)
        page.screenshot(path=out / f"studio-scene-{size}-{scheme}.png")


def pictures(dataset: Path, sequence: Path, out: Path, size: str, scheme: Literal["light", "dark"]) -> None:
    """Every other tab at one size; Live plays the sequence."""
    width, height = map(int, size.split("x"))
    for opened, tabs in ((dataset, TABS[:-1]), (sequence, TABS[-1:])):
        with studio(opened) as address, page_of(width, height, scheme) as page:
            page.goto(address)
            for name in tabs:
                page.get_by_role("tab", name=name).click()
                _PREPARED.get(name, lambda _: None)(page)
                page.wait_for_timeout(3000)
                page.screenshot(path=out / f"studio-{name.lower()}-{size}-{scheme}.png")


def _proposals(page: Any) -> None:
    choose(page, "proposals from", "in_car")
    page.get_by_text("proposal", exact=True).first.wait_for()


def _two_models(page: Any) -> None:
    for model in ("in_car", "five_seats"):
        if model != "in_car":
            page.get_by_label("model", exact=True).click()
            page.get_by_role("option", name=model, exact=True).click()
        page.get_by_role("button", name="Run").click()
        page.locator("tr", has_text=model).wait_for()


def _run(page: Any) -> None:
    for shown in ("cloud", "joints over time"):
        page.get_by_role("checkbox", name=shown).click()
    page.get_by_role("button", name="Start").click()
    page.wait_for_timeout(8000)


_PREPARED = {"Label": _proposals, "Compare": _two_models, "Live": _run}


def main() -> None:
    """Read the words behind the script and work."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("sequence", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--sizes", nargs="*", default=["1280x800", "1920x1080"])
    parser.add_argument("--webp", type=Path, help="folder of studio-TAB.webp and studio-TAB-dark.webp, made of the first size")
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    for size in chosen.sizes:
        for scheme in SCHEMES:
            scene_picture(chosen.scene, chosen.out, size, scheme)
            pictures(chosen.dataset, chosen.sequence, chosen.out, size, scheme)
    if chosen.webp is not None:
        for name in ("scene", *(tab.lower() for tab in TABS)):
            for scheme, end in zip(SCHEMES, ("", "-dark"), strict=True):
                picture = Image.open(chosen.out / f"studio-{name}-{chosen.sizes[0]}-{scheme}.png")
                picture.convert("RGB").save(chosen.webp / f"studio-{name}{end}.webp", quality=82, method=6)


if __name__ == "__main__":
    main()
